//! Conversion of replay buffers into arrays of a checkpoint, and back.

use rl::{ReplayBuffer, ReplayState, StepOutcome, StoredEpisode};

use crate::error::LearnerError;
use crate::learners::tensor_file::{CheckpointTensor, TensorFile};

use super::frame_codec::EpisodePictureCodec;

/// Value that stands for the episode index of an environment without a running episode.
const NO_EPISODE: u64 = u64::MAX;
/// Upper bound of the number of observations that contexts of running episodes need; limits the
/// memory that a damaged file can claim.
const MAX_CONTEXT_FRAMES: usize = 100_000;
/// Number of scalars that are written for every episode: steps, removed steps, outcome, and a flag
/// of contents.
const FIELDS: usize = 4;

/// Returns the contents of a replay buffer as arrays whose names begin with `prefix`.
pub fn replay_buffer_tensors(replay: &ReplayBuffer, prefix: &str) -> Vec<CheckpointTensor> {
    let state = replay.checkpoint_state();
    let name = |what: &str| format!("{prefix}replay.{what}");
    let integers = |what, width, values: &[u64]| {
        let shape = vec![values.len() / width, width];
        CheckpointTensor::from_integers(name(what), shape, values)
    };
    let floats = |what, of: for<'a> fn(&StoredEpisode<'a>) -> &'a [f32]| {
        let all: Vec<f32> = state.stored_episodes.iter().flat_map(of).copied().collect();
        CheckpointTensor::from_floats(name(what), vec![all.len()], &all)
    };
    let running = state.running_episodes.iter();
    let running: Vec<u64> = running.map(|n| n.map_or(NO_EPISODE, u64::from)).collect();
    let order = state.step_order.iter().flatten();
    let order: Vec<u64> = order.copied().map(u64::from).collect();
    let episodes: Vec<u64> = state.stored_episodes.iter().flat_map(numbers).collect();
    let pictures = pack(replay, &state);
    vec![
        integers("counts", 2, &[state.total_recorded_steps, state.num_before_newest]),
        integers("running", 1, &running),
        integers("order", 2, &order),
        integers("episodes", FIELDS, &episodes),
        CheckpointTensor::from_bytes(name("pictures"), vec![pictures.len()], pictures),
        floats("vectors", |episode| episode.vectors),
        floats("actions", |episode| episode.actions),
        floats("rewards", |episode| episode.rewards),
    ]
}

fn numbers(episode: &StoredEpisode<'_>) -> [u64; FIELDS] {
    let outcome = match episode.outcome {
        StepOutcome::Running => 0,
        StepOutcome::Terminated => 1,
        StepOutcome::Truncated => 2,
    };
    let (steps, removed) = (episode.rewards.len() as u64, u64::from(episode.removed));
    let is_there = u64::from(!episode.is_empty());
    [steps, removed, outcome, is_there]
}

/// Sizes of the arrays of a replay buffer, per observation or step.
struct Sizes {
    frames: EpisodePictureCodec,
    still: usize,
    vector: usize,
    action: usize,
}

impl Sizes {
    fn new(replay: &ReplayBuffer) -> Self {
        let (spec, still) = (replay.spec(), replay.settings().still_channels);
        let [height, width, channels] = spec.image_shape;
        let pixel = channels - still;
        Self {
            frames: EpisodePictureCodec {
                picture_bytes: height * width * pixel,
                pixel_bytes: pixel.max(1),
            },
            still: height * width * still,
            vector: spec.vector_irreps.len(),
            action: spec.action_irreps.len(),
        }
    }
}

/// Compresses the pictures of all episodes.
fn pack(replay: &ReplayBuffer, state: &ReplayState<'_>) -> Vec<u8> {
    let frames = Sizes::new(replay).frames;
    let (mut packed, mut pictures) = (Vec::new(), Vec::new());
    for episode in &state.stored_episodes {
        // still channels first: they have the size of a picture if half of the channels are still,
        // and then serve as the picture before the first one
        pictures.clear();
        pictures.extend_from_slice(episode.still);
        pictures.extend_from_slice(episode.moving);
        frames.pack(&mut pictures, &mut packed);
    }
    packed
}

/// Reads a replay buffer with the settings of `fresh` from the arrays that
/// [`replay_buffer_tensors`] returned.
///
/// # Errors
/// [`LearnerError::Read`] for arrays that are missing or do not fit.
pub fn read_replay_buffer(
    file: &TensorFile<'_>,
    prefix: &str,
    fresh: &ReplayBuffer,
) -> Result<ReplayBuffer, LearnerError> {
    let name = |what: &str| format!("{prefix}replay.{what}");
    let damaged = |what: &str| file.damaged_error(format!("`{}` does not fit", name(what)));
    let counts = file.read_integers(&name("counts"))?;
    let &[recorded, marked] = &counts[..] else {
        return Err(damaged("counts"));
    };
    let small = |what: &str, value: u64| u32::try_from(value).map_err(|_| damaged(what));
    let running = file.read_integers(&name("running"))?.into_iter();
    let running = running.map(|n| (n != NO_EPISODE).then(|| small("running", n)).transpose());
    let order = file.read_integers(&name("order"))?;
    let (order, _) = order.as_chunks::<2>();
    let order =
        order.iter().map(|&[episode, step]| Ok([small("order", episode)?, small("order", step)?]));
    let sizes = Sizes::new(fresh);
    // an episode has one more observation than steps, at most twice as many, and those of contexts
    let most_frames = 2 * fresh.settings().capacity + MAX_CONTEXT_FRAMES;
    let episodes = Episodes::read(file, &name, &sizes, most_frames)?;
    let state = ReplayState {
        total_recorded_steps: recorded,
        num_before_newest: marked,
        running_episodes: running.collect::<Result<_, LearnerError>>()?,
        step_order: order.collect::<Result<_, LearnerError>>()?,
        stored_episodes: episodes.states().ok_or_else(|| damaged("episodes"))?,
    };
    let restored = ReplayBuffer::restore(fresh.settings().clone(), fresh.spec(), &state);
    restored.map_err(|error| file.damaged_error(format!("`{}`: {error}", name("episodes"))))
}

/// Arrays of all stored episodes of a replay buffer, one episode after the other.
struct Episodes<'a> {
    sizes: &'a Sizes,
    rows: Vec<Row>,
    pictures: Vec<u8>,
    vectors: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
}

/// Scalars of a stored episode that its arrays do not hold.
struct Row {
    steps: usize,
    removed: u32,
    outcome: StepOutcome,
    is_there: bool,
}

impl Row {
    fn new(numbers: [u64; FIELDS]) -> Option<Self> {
        let [steps, removed, outcome, is_there] = numbers;
        Some(Self {
            steps: usize::try_from(steps).ok()?,
            removed: u32::try_from(removed).ok()?,
            outcome: match outcome {
                0 => StepOutcome::Running,
                1 => StepOutcome::Terminated,
                2 => StepOutcome::Truncated,
                _ => return None,
            },
            is_there: is_there == 1,
        })
    }

    /// Returns the number of stored observations of the episode.
    fn frames(&self) -> usize {
        if self.is_there { self.steps + 1 } else { 0 }
    }

    /// Returns the number of bytes of the episode's picture channels that do not change.
    fn still(&self, sizes: &Sizes) -> usize {
        if self.is_there { sizes.still } else { 0 }
    }

    /// Returns the number of bytes of the episode's pictures, all channels together.
    fn pictures(&self, sizes: &Sizes) -> usize {
        self.still(sizes) + self.frames() * sizes.frames.picture_bytes
    }
}

/// Reads the scalars of episodes; `None` if the episodes do not have `steps` steps in total.
fn rows(numbers: &[u64], steps: usize) -> Option<Vec<Row>> {
    let (numbers, _) = numbers.as_chunks::<FIELDS>();
    let rows: Vec<Row> = numbers.iter().copied().map(Row::new).collect::<Option<_>>()?;
    let mut rest = steps;
    for row in &rows {
        rest = rest.checked_sub(row.steps)?;
    }
    (rest == 0).then_some(rows)
}

impl<'a> Episodes<'a> {
    fn read(
        file: &TensorFile<'_>,
        name: &impl Fn(&str) -> String,
        sizes: &'a Sizes,
        most_frames: usize,
    ) -> Result<Self, LearnerError> {
        let damaged = |what: &str| file.damaged_error(format!("`{}` does not fit", name(what)));
        let floats = |what: &str| Ok::<_, LearnerError>(file.read_floats(&name(what))?.1);
        let rewards = floats("rewards")?;
        let rows = rows(&file.read_integers(&name("episodes"))?, rewards.len());
        let rows = rows.ok_or_else(|| damaged("episodes"))?;
        let vectors = floats("vectors")?;
        // checked before pictures are unpacked, since a few damaged bytes could claim all memory
        let frames: usize = rows.iter().map(Row::frames).sum();
        if frames > most_frames || vectors.len() != frames.saturating_mul(sizes.vector) {
            return Err(damaged("vectors"));
        }
        let (_, packed) = file.read_bytes(&name("pictures"))?;
        let pictures = unpack(&rows, sizes, &packed);
        Ok(Self {
            pictures: pictures.ok_or_else(|| damaged("pictures"))?,
            vectors,
            actions: floats("actions")?,
            rewards,
            rows,
            sizes,
        })
    }

    fn states(&self) -> Option<Vec<StoredEpisode<'_>>> {
        let (mut pictures, mut vectors) = (&self.pictures[..], &self.vectors[..]);
        let (mut actions, mut rewards) = (&self.actions[..], &self.rewards[..]);
        let state = |row: &Row| {
            Some(StoredEpisode {
                still: pictures.split_off(..row.still(self.sizes))?,
                moving: pictures.split_off(..row.frames() * self.sizes.frames.picture_bytes)?,
                vectors: vectors.split_off(..row.frames() * self.sizes.vector)?,
                actions: actions.split_off(..row.steps * self.sizes.action)?,
                rewards: rewards.split_off(..row.steps)?,
                outcome: row.outcome,
                removed: row.removed,
            })
        };
        self.rows.iter().map(state).collect()
    }
}

fn unpack(rows: &[Row], sizes: &Sizes, mut packed: &[u8]) -> Option<Vec<u8>> {
    let all = rows.iter().map(|row| row.pictures(sizes)).sum();
    let mut pictures = Vec::new();
    pictures.try_reserve_exact(all).ok()?;
    pictures.resize(all, 0);
    let mut rest = &mut pictures[..];
    for row in rows {
        let own = rest.split_off_mut(..row.pictures(sizes))?;
        packed = sizes.frames.unpack(packed, own)?;
    }
    packed.is_empty().then_some(pictures)
}

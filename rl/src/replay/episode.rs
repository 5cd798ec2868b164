//! One episode of a replay buffer.

use crate::env::{EnvSpec, StepOutcome};

/// Number of steps that an episode keeps as history after they left the replay buffer; more than
/// the 64 steps that a recurrent context may read.
const HISTORY: usize = 256;

/// Sizes of the data of one step: pixels and channels of the image, components of vector and
/// action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    pub pixels: usize,
    /// Number of channels of a pixel that may change during an episode.
    pub moving: usize,
    /// Number of channels of a pixel that stay the same during an episode.
    pub still: usize,
    pub vector: usize,
    pub action: usize,
}

impl Sizes {
    pub fn new(spec: &EnvSpec, still_channels: usize) -> Self {
        let [height, width, channels] = spec.image_shape;
        Self {
            pixels: height * width,
            moving: channels - still_channels,
            still: still_channels,
            vector: spec.vector_irreps.len(),
            action: spec.action_irreps.len(),
        }
    }

    /// Returns the number of bytes of an image's moving channels.
    pub fn moving_channels_len(&self) -> usize {
        self.pixels * self.moving
    }

    /// Returns the number of bytes of an image's still channels.
    pub fn still_channels_len(&self) -> usize {
        self.pixels * self.still
    }

    /// Splits every pixel of an image into its moving and its still channels.
    fn split<'a>(&self, image: &'a [u8]) -> impl Iterator<Item = (&'a [u8], &'a [u8])> {
        let moving = self.moving;
        let pixels = image.chunks_exact((self.moving + self.still).max(1));
        pixels.map(move |pixel| pixel.split_at(moving))
    }
}

/// An episode, running or ended: T steps and the T + 1 observations around them. The first steps of
/// an episode longer than the buffer are removed.
#[derive(Clone, Default)]
pub(super) struct Episode {
    /// Still channels of the episode's images, `[H, W, S]` for S channels that do not change in an
    /// episode.
    pub still: Vec<u8>,
    /// Moving channels of the episode's images, `[T + 1, H, W, C - S]` for S still ones of C
    /// channels.
    pub moving: Vec<u8>,
    /// Observation vectors of the episode, `[T + 1, D]`.
    pub vectors: Vec<f32>,
    /// Actions of the episode's steps, `[T, A]`.
    pub actions: Vec<f32>,
    /// Rewards of the episode's steps, `[T]`.
    pub rewards: Vec<f32>,
    /// State of the episode after its last step.
    pub outcome: StepOutcome,
    /// Number of steps removed from the front of the episode.
    pub removed: usize,
    /// Number of the episode's last steps that the replay buffer still holds.
    pub num_held: usize,
}

impl Episode {
    /// Creates an episode with its first observation. Its images reuse the allocation of `moving`.
    pub fn begin(sizes: &Sizes, image: &[u8], vector: &[f32], mut moving: Vec<u8>) -> Self {
        moving.clear();
        let mut episode = Self { moving, ..Self::default() };
        // once for the episode; later images are compared with them
        for (_, still) in sizes.split(image) {
            episode.still.extend_from_slice(still);
        }
        episode.observe(sizes, image, vector);
        episode
    }

    fn observe(&mut self, sizes: &Sizes, image: &[u8], vector: &[f32]) {
        self.moving.reserve(sizes.moving_channels_len());
        for (moving, _) in sizes.split(image) {
            self.moving.extend_from_slice(moving);
        }
        self.vectors.extend_from_slice(vector);
    }

    /// Appends a step and the observation after it to the episode.
    pub fn push(
        &mut self,
        sizes: &Sizes,
        action: &[f32],
        reward: f32,
        outcome: StepOutcome,
        next_image: &[u8],
        next_vector: &[f32],
    ) {
        self.actions.extend_from_slice(action);
        self.rewards.push(reward);
        self.outcome = outcome;
        self.observe(sizes, next_image, next_vector);
        self.num_held += 1;
        if outcome.is_ended() {
            self.shrink_to_fit();
        }
    }

    /// Frees memory that was allocated for further steps of the episode.
    pub fn shrink_to_fit(&mut self) {
        self.moving.shrink_to_fit();
        self.vectors.shrink_to_fit();
        self.actions.shrink_to_fit();
        self.rewards.shrink_to_fit();
    }

    /// Returns T, the number of steps stored for the episode.
    pub fn num_steps(&self) -> usize {
        self.rewards.len()
    }

    /// Drops the oldest held step of the episode, whose memory is freed later together with that of
    /// many others.
    pub fn drop_oldest_step(&mut self, sizes: &Sizes) {
        self.num_held -= 1;
        let dropped = self.num_steps() - self.num_held;
        // removal moves the rest of the arrays, so it waits until it frees more than it moves
        if dropped > self.num_held + 2 * HISTORY {
            let count = dropped - HISTORY;
            self.moving.drain(..count * sizes.moving_channels_len());
            self.vectors.drain(..count * sizes.vector);
            self.actions.drain(..count * sizes.action);
            self.rewards.drain(..count);
            self.removed += count;
            self.shrink_to_fit();
        }
    }

    /// Returns `true` if an image's still channels equal those of the episode.
    pub fn has_same_still_channels(&self, sizes: &Sizes, image: &[u8]) -> bool {
        let mut own = self.still.chunks(sizes.still.max(1));
        sizes.still == 0 || sizes.split(image).all(|(_, still)| own.next() == Some(still))
    }

    /// Returns `true` if `image` and `vector` are the last observation of the episode.
    pub fn last_observation_equals(&self, sizes: &Sizes, image: &[u8], vector: &[f32]) -> bool {
        let last = &self.moving[self.num_steps() * sizes.moving_channels_len()..];
        let mut own = last.chunks(sizes.moving.max(1));
        let mut moving = || sizes.split(image).all(|(moving, _)| own.next() == Some(moving));
        self.vectors[self.num_steps() * sizes.vector..] == *vector
            && (sizes.moving == 0 || moving())
            && self.has_same_still_channels(sizes, image)
    }

    /// Writes image `t` of the episode, in 0..=T, as the environment returned it.
    pub fn write_image(&self, sizes: &Sizes, t: usize, out: &mut [u8]) {
        let moving = &self.moving[t * sizes.moving_channels_len()..][..sizes.moving_channels_len()];
        if sizes.still == 0 {
            out.copy_from_slice(moving);
            return;
        }
        let channels = sizes.moving + sizes.still;
        // channel by channel: a copy for every pixel would be a call for a few bytes each
        for (first, own, from) in
            [(0, sizes.moving, moving), (sizes.moving, sizes.still, &self.still)]
        {
            for c in 0..own {
                let to = out[first + c..].iter_mut().step_by(channels);
                let from = from[c..].iter().step_by(own);
                to.zip(from).for_each(|(to, &value)| *to = value);
            }
        }
    }

    /// Returns the number of bytes allocated for the episode.
    pub fn allocated_bytes(&self) -> usize {
        let floats = [&self.vectors, &self.actions, &self.rewards].map(Vec::capacity);
        let bytes = self.still.capacity() + self.moving.capacity();
        bytes + floats.iter().sum::<usize>() * size_of::<f32>() + size_of::<Self>()
    }
}

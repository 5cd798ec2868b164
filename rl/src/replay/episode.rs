//! One episode of a replay.

use crate::env::{EnvSpec, Outcome};

/// Dropped steps of an episode that are kept as the history of those that are held.
const HISTORY: usize = 256;

/// Lengths of the arrays of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    pub pixels: usize,
    /// Channels of a pixel that move, and that stand still.
    pub moving: usize,
    pub still: usize,
    pub vector: usize,
    pub action: usize,
}

impl Sizes {
    pub fn new(spec: &EnvSpec, still_channels: usize) -> Self {
        let [height, width, channels] = spec.image;
        Self {
            pixels: height * width,
            moving: channels - still_channels,
            still: still_channels,
            vector: spec.vector.len(),
            action: spec.action.len(),
        }
    }

    /// Bytes of a picture's channels that move.
    pub fn moving_len(&self) -> usize {
        self.pixels * self.moving
    }

    /// Bytes of a picture's channels that stand still.
    pub fn still_len(&self) -> usize {
        self.pixels * self.still
    }

    /// The moving and the still channels of every pixel of a picture.
    fn split<'a>(&self, image: &'a [u8]) -> impl Iterator<Item = (&'a [u8], &'a [u8])> {
        let moving = self.moving;
        let pixels = image.chunks_exact((self.moving + self.still).max(1));
        pixels.map(move |pixel| pixel.split_at(moving))
    }
}

/// An episode so far, or as it ended: T steps and the T + 1 observations around them. Of an episode
/// that outlasts the replay, the first steps are removed.
#[derive(Clone, Default)]
pub(super) struct Episode {
    /// Channels that stand still, `[H, W, S]`.
    pub still: Vec<u8>,
    /// Channels that move, `[T + 1, H, W, C - S]`.
    pub moving: Vec<u8>,
    /// Observation vectors `[T + 1, D]`.
    pub vectors: Vec<f32>,
    /// Actions `[T, A]`.
    pub actions: Vec<f32>,
    /// Rewards `[T]`.
    pub rewards: Vec<f32>,
    /// Outcome of the last step.
    pub outcome: Outcome,
    /// Steps removed from the front.
    pub removed: usize,
    /// Steps that the replay has not dropped: the last ones.
    pub held: usize,
}

impl Episode {
    /// An episode with its first observation. Its pictures take the memory of `moving`, whatever
    /// that holds.
    pub fn begin(sizes: &Sizes, (image, vector): (&[u8], &[f32]), mut moving: Vec<u8>) -> Self {
        moving.clear();
        let mut episode = Self { moving, ..Self::default() };
        for (_, still) in sizes.split(image) {
            episode.still.extend_from_slice(still);
        }
        episode.observe(sizes, (image, vector));
        episode
    }

    fn observe(&mut self, sizes: &Sizes, (image, vector): (&[u8], &[f32])) {
        self.moving.reserve(sizes.moving_len());
        for (moving, _) in sizes.split(image) {
            self.moving.extend_from_slice(moving);
        }
        self.vectors.extend_from_slice(vector);
    }

    /// Appends a step and the observation that it led to.
    pub fn push(
        &mut self,
        sizes: &Sizes,
        action: &[f32],
        (reward, outcome): (f32, Outcome),
        next: (&[u8], &[f32]),
    ) {
        self.actions.extend_from_slice(action);
        self.rewards.push(reward);
        self.outcome = outcome;
        self.observe(sizes, next);
        self.held += 1;
        if outcome.ended() {
            self.shrink();
        }
    }

    /// Gives back what was allocated for steps that will not come.
    pub fn shrink(&mut self) {
        self.moving.shrink_to_fit();
        self.vectors.shrink_to_fit();
        self.actions.shrink_to_fit();
        self.rewards.shrink_to_fit();
    }

    /// T, the number of steps that are stored.
    pub fn steps(&self) -> usize {
        self.rewards.len()
    }

    /// Lets the replay drop the oldest step. Its memory is freed later and for many at once, unless
    /// it ends with the whole episode.
    pub fn drop_oldest(&mut self, sizes: &Sizes) {
        self.held -= 1;
        let dropped = self.steps() - self.held;
        if dropped > self.held + 2 * HISTORY {
            let count = dropped - HISTORY;
            self.moving.drain(..count * sizes.moving_len());
            self.vectors.drain(..count * sizes.vector);
            self.actions.drain(..count * sizes.action);
            self.rewards.drain(..count);
            self.removed += count;
            self.shrink();
        }
    }

    /// Returns `true` if the channels of a picture that stand still are those of the episode.
    pub fn stands_still(&self, sizes: &Sizes, image: &[u8]) -> bool {
        let mut own = self.still.chunks(sizes.still.max(1));
        sizes.still == 0 || sizes.split(image).all(|(_, still)| own.next() == Some(still))
    }

    /// Returns `true` if an observation is the last one of the episode.
    pub fn ends_with(&self, sizes: &Sizes, (image, vector): (&[u8], &[f32])) -> bool {
        let last = &self.moving[self.steps() * sizes.moving_len()..];
        let mut own = last.chunks(sizes.moving.max(1));
        let mut moving = || sizes.split(image).all(|(moving, _)| own.next() == Some(moving));
        self.vectors[self.steps() * sizes.vector..] == *vector
            && (sizes.moving == 0 || moving())
            && self.stands_still(sizes, image)
    }

    /// Writes picture `t`, in 0..=T, as the environment gave it.
    pub fn image(&self, sizes: &Sizes, t: usize, out: &mut [u8]) {
        let moving = &self.moving[t * sizes.moving_len()..][..sizes.moving_len()];
        let channels = sizes.moving + sizes.still;
        // channel by channel, so that no pixel is copied by a call of its own
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

    /// Bytes allocated for the arrays.
    pub fn bytes(&self) -> usize {
        let floats = [&self.vectors, &self.actions, &self.rewards].map(Vec::capacity);
        let floats = floats.iter().sum::<usize>() * size_of::<f32>();
        self.still.capacity() + self.moving.capacity() + floats + size_of::<Self>()
    }
}

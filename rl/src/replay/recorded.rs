//! One step of a replay, as it was recorded.

use std::fmt;

use crate::env::Outcome;
use crate::replay::episode::{Episode, Sizes};

/// Where an observation lies: it is that before step `step` of the episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    /// Number of the episode, counted from the first one ever.
    pub episode: u32,
    pub step: u32,
}

/// A step that a [`Replay`](crate::Replay) holds: an observation, an action, a reward and the
/// observation after it.
#[derive(Clone, Copy)]
pub struct Recorded<'a> {
    pub(super) episode: &'a Episode,
    pub(super) sizes: &'a Sizes,
    /// Number of the episode, counted from the first one ever.
    pub(super) number: u32,
    /// Position among the episode's stored steps.
    pub(super) step: usize,
}

impl<'a> Recorded<'a> {
    /// Position in the episode, from 0.
    pub fn step(&self) -> usize {
        self.episode.removed + self.step
    }

    /// Where the observation lies that was acted on.
    pub(crate) fn place(&self) -> Place {
        Place {
            episode: self.number,
            step: self.step() as u32,
        }
    }

    /// Where the observation after the step lies.
    pub(crate) fn next_place(&self) -> Place {
        let Place { episode, step } = self.place();
        Place {
            episode,
            step: step + 1,
        }
    }

    /// Writes the picture `[H, W, C]` that was acted on.
    ///
    /// # Panics
    /// When `out` does not hold a picture.
    pub fn image(&self, out: &mut [u8]) {
        self.episode.image(self.sizes, self.step, out);
    }

    /// The vector `[D]` that was acted on.
    pub fn vector(&self) -> &'a [f32] {
        row(&self.episode.vectors, self.step, self.sizes.vector)
    }

    /// The action `[A]` that was executed.
    pub fn action(&self) -> &'a [f32] {
        row(&self.episode.actions, self.step, self.sizes.action)
    }

    /// The reward.
    pub fn reward(&self) -> f32 {
        self.episode.rewards[self.step]
    }

    /// How the step left the episode. A running episode that
    /// [`Replay::cut`](crate::Replay::cut) stopped stays [`Outcome::Running`].
    pub fn outcome(&self) -> Outcome {
        if self.step + 1 == self.episode.steps() {
            self.episode.outcome
        } else {
            Outcome::Running
        }
    }

    /// Writes the picture `[H, W, C]` after the step; where the episode ended, its last one.
    ///
    /// # Panics
    /// When `out` does not hold a picture.
    pub fn next_image(&self, out: &mut [u8]) {
        self.episode.image(self.sizes, self.step + 1, out);
    }

    /// The vector `[D]` after the step; where the episode ended, its last one.
    pub fn next_vector(&self) -> &'a [f32] {
        row(&self.episode.vectors, self.step + 1, self.sizes.vector)
    }

    /// The step `count` before this one; none where the episode begins later. Of an episode that is
    /// longer than the replay's capacity, at least 256 dropped steps are still there.
    pub fn earlier(&self, count: usize) -> Option<Self> {
        let step = self.step.checked_sub(count)?;
        Some(Self { step, ..*self })
    }

    /// The step `count` further among those of its episode that the replay holds; after the last
    /// comes the first of them. So, from a held step that is drawn uniformly, one gets to another
    /// that is.
    pub(crate) fn along(&self, count: usize) -> Self {
        let first = self.episode.steps() - self.episode.held;
        let step = first + (self.step - first + count) % self.episode.held;
        Self { step, ..*self }
    }
}

impl fmt::Debug for Recorded<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recorded")
            .field("place", &self.place())
            .field("action", &self.action())
            .field("reward", &self.reward())
            .field("outcome", &self.outcome())
            .finish_non_exhaustive()
    }
}

fn row(values: &[f32], i: usize, width: usize) -> &[f32] {
    &values[i * width..(i + 1) * width]
}

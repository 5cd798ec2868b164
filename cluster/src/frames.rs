//! Feature vectors of the first frames of episodes.

use crate::check::{check_positive, check_rows};
use crate::error::{ClusterError, Result};

/// Feature vectors of the first frames of episodes, `[episodes, frames_per_episode, dim]`, all
/// finite.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFeatures {
    features: Vec<f32>,
    frames_per_episode: usize,
    dim: usize,
}

impl FrameFeatures {
    /// Creates frames from the features `[episodes, frames_per_episode, dim]` of at least one
    /// episode.
    ///
    /// # Errors
    /// No episode, a partial episode, a zero size, or a value that is not finite.
    pub fn new(features: Vec<f32>, frames_per_episode: usize, dim: usize) -> Result<Self> {
        check_positive("frames_per_episode", frames_per_episode)?;
        check_positive("dim", dim)?;
        check_rows("features", &features, frames_per_episode.saturating_mul(dim), "episode")?;
        Ok(Self { features, frames_per_episode, dim })
    }

    /// Returns the features of all frames, `[episodes, frames_per_episode, dim]`.
    pub fn features(&self) -> &[f32] {
        &self.features
    }

    /// Returns the number of episodes, at least 1.
    pub fn num_episodes(&self) -> usize {
        self.features.len() / (self.frames_per_episode * self.dim)
    }

    /// Returns the number of frames of each episode (the paper's `k`).
    pub fn frames_per_episode(&self) -> usize {
        self.frames_per_episode
    }

    /// Returns the number of features of each frame.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// Rejects `other` if it has another number of features, or of frames in each episode.
    pub(crate) fn check_alike(&self, other: &Self) -> Result<()> {
        let (ours, theirs) = (self.frames_per_episode, other.frames_per_episode);
        let sizes = [("dim", self.dim, other.dim), ("frames_per_episode", ours, theirs)];
        match sizes.into_iter().find(|(_, first, second)| first != second) {
            Some((what, first, second)) => {
                Err(ClusterError::FramesMismatch { what, first, second })
            }
            None => Ok(()),
        }
    }
}

/// Candidate policy for a rollout: the frames of its buffer and of the rollout, both as features of
/// the policy's network.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutAndBufferFeatures {
    /// Frames of the policy's buffer `B_j`.
    pub buffer: FrameFeatures,
    /// Frames of the rollout, `O`.
    pub rollout: FrameFeatures,
}

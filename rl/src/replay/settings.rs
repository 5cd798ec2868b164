//! Settings of a replay.

use serde::{Deserialize, Serialize};

use crate::env::EnvSpec;
use crate::error::RlError;
use crate::require::require;

/// Settings of [`crate::Replay`]. Capacity and warm-up of the default are those of CLEAR and 3RL in
/// COVERS (Liu et al., CoRL 2023, appendix, table "CLEAR and 3RL Hyperparameter").
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReplaySettings {
    /// Steps held at most, at least 1; beyond them, every new one replaces the oldest.
    pub capacity: usize,
    /// Steps of every environment in one collection, at least 1.
    pub steps: usize,
    /// Decisions at the beginning whose actions are drawn uniformly from [-1, 1].
    pub warm_up: u64,
    /// How many channels, the last ones of a picture, stand still during an episode. They are
    /// stored once for each episode.
    pub still_channels: usize,
}

impl Default for ReplaySettings {
    fn default() -> Self {
        Self {
            capacity: 200_000,
            steps: 50,
            warm_up: 1000,
            still_channels: 0,
        }
    }
}

impl ReplaySettings {
    /// Refuses values outside their ranges, and more still channels than pictures have.
    ///
    /// # Errors
    /// [`RlError::Setting`] names the field, its value and its range.
    pub fn check(&self, spec: &EnvSpec) -> Result<(), RlError> {
        let places = 1..=u32::MAX as usize;
        let (capacity, still) = (self.capacity, self.still_channels);
        let allowed = places.contains(&capacity);
        require("capacity", capacity as f32, "1 to 2^32 - 1 steps", allowed)?;
        let allowed = self.steps > 0;
        require("steps", self.steps as f32, "at least 1 step", allowed)?;
        let expected = "at most the channels of a picture";
        let allowed = still <= spec.image[2];
        require("still_channels", still as f32, expected, allowed)
    }
}

//! What the settings of every collection of policies say.

use rl::EnvSpec;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::groupings::GroupingSettings;

/// Settings of a learner that is a collection of policies.
pub trait CollectionSettings:
    Clone + PartialEq + Serialize + DeserializeOwned + Send + 'static
{
    /// What every collection needs to know.
    fn shared(&self) -> Shared;
}

/// What every collection needs to know; the fields are those of
/// [`CoversSettings`](crate::CoversSettings).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shared {
    /// Which policy a rollout belongs to.
    pub grouping: GroupingSettings,
    /// Frames at the start of each episode that assignment looks at.
    pub first_frames: usize,
    /// Decisions of one rollout.
    pub rollout_steps: usize,
    /// Episodes of first frames kept per policy; without a number all of them.
    pub buffer_episodes: Option<usize>,
    /// What becomes of a rollout that changes hands.
    pub handover: Handover,
    /// Which features of a policy's frames assignment compares.
    pub embedding: Embedding,
    /// Where a new policy starts.
    pub new_policy: NewPolicy,
    /// Seed of everything that the learner draws.
    pub seed: u64,
}

/// What becomes of a rollout that another policy is assigned to than the one that collected it. The
/// paper's Algorithm 1 updates the assigned policy with it and does not say how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Handover {
    /// Its first frames feed the buffer; the assigned policy collects a rollout of its own to learn
    /// from. Both count as decisions.
    #[default]
    CollectAgain,
    /// The assigned policy learns from it, with its own log-probabilities and values
    /// ([`RolloutBuffer::revalue`](rl::RolloutBuffer::revalue)).
    Reuse,
}

/// Which features of a policy's frames assignment compares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Embedding {
    /// Those of the policy as it is now: features drift while a policy learns.
    #[default]
    Afresh,
    /// Those of the policy as it was when the frames arrived, before it learnt from their rollout.
    AtArrival,
}

/// Where a new policy starts; its optimiser is fresh in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NewPolicy {
    /// From random parameters, as in the paper.
    #[default]
    Random,
    /// From the parameters of the nearest policy, its exploration included.
    Copy,
}

impl Shared {
    /// Episodes that a buffer holds at most.
    pub(super) fn buffer_capacity(&self) -> usize {
        self.buffer_episodes.unwrap_or(usize::MAX)
    }

    /// Decisions of each environment in a rollout, once the settings are found to fit the
    /// environments and each other. A policy must keep `min_episodes` for the grouping.
    pub(super) fn steps_per_env(
        &self,
        spec: &EnvSpec,
        min_episodes: usize,
    ) -> Result<usize, CoversError> {
        let setting = |name, value: usize, expected| CoversError::Setting {
            name,
            value: value.to_string(),
            expected,
        };
        if self.first_frames == 0 {
            return Err(setting("first_frames", 0, "at least 1 frame"));
        }
        if let Some(episodes) = self.buffer_episodes
            && episodes < min_episodes
        {
            let expected = "at least the min_episodes of the grouping";
            return Err(setting("buffer_episodes", episodes, expected));
        }
        if spec.num_envs == 0 || !self.rollout_steps.is_multiple_of(spec.num_envs) {
            let expected = "a multiple of the number of environments";
            return Err(setting("rollout_steps", self.rollout_steps, expected));
        }
        let steps = self.rollout_steps / spec.num_envs;
        if steps < self.first_frames {
            let expected = "at least first_frames decisions in every environment";
            return Err(setting("rollout_steps", self.rollout_steps, expected));
        }
        Ok(steps)
    }
}

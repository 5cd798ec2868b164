//! Settings of the learner. Where the paper leaves a gap or this project departs from it, the
//! paper's reading is a value, too.

use rl::{EnvSpec, NetworkSettings, PpoSettings};
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::groupings::GroupingSettings;

/// Settings of [`Covers`](crate::Covers).
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoversSettings {
    /// Sizes of each policy's network.
    pub network: NetworkSettings,
    /// The policy update.
    pub ppo: PpoSettings,
    /// Which policy a rollout belongs to.
    pub grouping: GroupingSettings,
    /// Frames at the start of each episode that assignment looks at: the paper's `k`. It is 4
    /// there; here a decision holds ten control steps, and only the very first frame does not
    /// depend on the policy that acts.
    pub first_frames: usize,
    /// Decisions of one rollout: the paper's `N_s`, and its `N_u`, since both count steps.
    pub rollout_steps: usize,
    /// Episodes of first frames kept per policy, a uniform sample; without a number all of them, as
    /// the paper's `B`, at the price of memory and of transport problems that grow with the stream.
    pub buffer_episodes: Option<usize>,
    /// What becomes of a rollout that another policy is assigned to than the one that collected it.
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

impl Default for CoversSettings {
    fn default() -> Self {
        Self {
            network: NetworkSettings::default(),
            ppo: PpoSettings::default(),
            grouping: GroupingSettings::default(),
            first_frames: 1,
            rollout_steps: 1000,
            buffer_episodes: Some(100),
            handover: Handover::default(),
            embedding: Embedding::default(),
            new_policy: NewPolicy::default(),
            seed: 0,
        }
    }
}

impl CoversSettings {
    /// The paper's method and hyper-parameters, read literally (section 4, Algorithm 1 and
    /// appendix). Its network takes pictures of 128 x 128 pixels: set the camera's size, too, or
    /// put another network.
    pub fn paper() -> Self {
        Self {
            network: NetworkSettings::so2_128(),
            ppo: PpoSettings::paper(),
            grouping: GroupingSettings::PAPER,
            first_frames: 4,
            rollout_steps: 1000,
            buffer_episodes: None,
            handover: Handover::Reuse,
            embedding: Embedding::Afresh,
            new_policy: NewPolicy::Random,
            seed: 0,
        }
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file() {
        let other = CoversSettings {
            embedding: Embedding::AtArrival,
            new_policy: NewPolicy::Copy,
            seed: u64::MAX,
            ..CoversSettings::paper()
        };
        for settings in [CoversSettings::default(), CoversSettings::paper(), other] {
            let text = serde_json::to_string(&settings).unwrap();
            let read: CoversSettings = serde_json::from_str(&text).unwrap();
            assert_eq!(read, settings);
        }
        let read = |text| serde_json::from_str::<CoversSettings>(text);
        assert_eq!(read("{}").unwrap(), CoversSettings::default());
        assert!(read(r#"{"hand_over": "reuse"}"#).is_err());
        assert!(read(r#"{"handover": "keep"}"#).is_err());
    }
}

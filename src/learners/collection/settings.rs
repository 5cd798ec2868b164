//! What the settings of every collection of policies say and make.

use rl::{EnvSpec, RlError};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::groupings::GroupingSettings;

use super::training::Training;

/// Settings of a learner that is a collection of policies.
pub trait CollectionSettings:
    Clone + PartialEq + Serialize + DeserializeOwned + Send + 'static
{
    /// How the policies are trained.
    type Training: Training;

    /// Which policy a rollout belongs to.
    fn grouping(&self) -> GroupingSettings;

    /// Frames at the start of each episode that assignment looks at.
    fn first_frames(&self) -> usize;

    /// Decisions of one rollout.
    fn rollout_steps(&self) -> usize;

    /// Episodes of first frames kept per policy; without a number all of them.
    fn buffer_episodes(&self) -> Option<usize>;

    /// What becomes of a rollout that changes hands.
    fn handover(&self) -> Handover;

    /// Where a new policy starts.
    fn new_policy(&self) -> NewPolicy;

    /// Seed of everything that the learner draws.
    fn seed(&self) -> u64;

    /// A random policy.
    ///
    /// # Errors
    /// Images that the network cannot take, or a setting out of range.
    fn policy(&self, spec: &EnvSpec, seed: u64) -> Result<PolicyOf<Self>, RlError>;

    /// The policy of these parameters.
    ///
    /// # Errors
    /// As [`CollectionSettings::policy`], and parameters that are not the network's.
    fn with_params(&self, spec: &EnvSpec, params: Vec<f32>) -> Result<PolicyOf<Self>, RlError>;

    /// All parameters of a policy.
    fn params(policy: &PolicyOf<Self>) -> &[f32];

    /// Room for rollouts of `steps` steps of every environment.
    ///
    /// # Errors
    /// Sizes of zero, or more memory than there is.
    fn rollout(&self, spec: &EnvSpec, steps: usize) -> Result<RolloutOf<Self>, RlError>;

    /// Fresh training of `policy`.
    ///
    /// # Errors
    /// A setting out of range.
    fn training(&self, spec: &EnvSpec, policy: &PolicyOf<Self>) -> Result<Self::Training, RlError>;
}

/// Implements the methods of [`CollectionSettings`] that return the field of their name.
macro_rules! shared_settings {
    ($($name:ident: $kind:ty),+) => {
        $(fn $name(&self) -> $kind { self.$name })+
    };
}

pub(in crate::learners) use shared_settings;

/// The policies of a collection of these settings.
pub type PolicyOf<S> = <<S as CollectionSettings>::Training as Training>::Policy;
/// What their rollouts are kept in.
pub type RolloutOf<S> = <<S as CollectionSettings>::Training as Training>::Rollout;

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
    /// ([`RolloutBuffer::revalue`](rl::RolloutBuffer::revalue)), unless it shows two groups.
    Reuse,
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

/// Episodes that a buffer holds at most.
pub(super) fn buffer_capacity<S: CollectionSettings>(settings: &S) -> usize {
    settings.buffer_episodes().unwrap_or(usize::MAX)
}

/// Decisions of each environment in a rollout, once the settings are found to fit the environments
/// and each other. A policy must keep `min_episodes` for the grouping.
pub(super) fn steps_per_env<S: CollectionSettings>(
    settings: &S,
    spec: &EnvSpec,
    min_episodes: usize,
) -> Result<usize, CoversError> {
    let setting = |name, value: usize, expected| CoversError::Setting {
        name,
        value: value.to_string(),
        expected,
    };
    let (first_frames, rollout_steps) = (settings.first_frames(), settings.rollout_steps());
    if first_frames == 0 {
        return Err(setting("first_frames", 0, "at least 1 frame"));
    }
    if let Some(episodes) = settings.buffer_episodes()
        && episodes < min_episodes
    {
        let expected = "at least the min_episodes of the grouping";
        return Err(setting("buffer_episodes", episodes, expected));
    }
    if spec.num_envs == 0 || !rollout_steps.is_multiple_of(spec.num_envs) {
        let expected = "a multiple of the number of environments";
        return Err(setting("rollout_steps", rollout_steps, expected));
    }
    let steps = rollout_steps / spec.num_envs;
    if steps < first_frames {
        let expected = "at least first_frames decisions in every environment";
        return Err(setting("rollout_steps", rollout_steps, expected));
    }
    Ok(steps)
}

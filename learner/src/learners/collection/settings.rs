//! Settings of every collection of policies, and the trait for the training of one policy.

use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, AlgorithmState, EnvSpec, ExperienceBuffer, ExportPolicy, FeatureExtractor,
    MeasureUnitActivity, RlError, RolloutState,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::LearnerError;
use crate::groupings::GroupingSettings;
use crate::learners::tensor_file::{CheckpointTensor, TensorFile};

use super::episodes::Rollout;

/// Settings of a collection of policies, which also create its policies, their trainers and its
/// storage for rollouts.
pub trait PolicyCollectionSettings:
    Clone + PartialEq + Serialize + DeserializeOwned + Send + 'static
{
    /// Algorithm that trains a policy, with its state.
    type Trainer: PolicyTrainer;

    /// Returns the settings that do not depend on the training algorithm.
    fn common(&self) -> CommonSettings;

    /// Creates a randomly initialised policy for the environments of `spec`.
    ///
    /// # Errors
    /// Images that the network cannot take, or a setting out of range.
    fn new_policy(&self, spec: &EnvSpec, seed: u64) -> Result<PolicyInCollection<Self>, RlError>;

    /// Creates a policy for the environments of `spec` with the parameters `params`.
    ///
    /// # Errors
    /// Errors of [`PolicyCollectionSettings::new_policy`], and parameters that are not the
    /// network's.
    fn policy_with_params(
        &self,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<PolicyInCollection<Self>, RlError>;

    /// Returns all parameters of a policy as a flat slice.
    fn params(policy: &PolicyInCollection<Self>) -> &[f32];

    /// Creates storage for rollouts of `steps` steps in every environment.
    ///
    /// # Errors
    /// Sizes of zero, or more memory than there is.
    fn new_rollout(
        &self,
        spec: &EnvSpec,
        steps: usize,
    ) -> Result<RolloutInCollection<Self>, RlError>;

    /// Creates the initial state of the training of `policy`.
    ///
    /// # Errors
    /// A setting out of range.
    fn new_training(
        &self,
        spec: &EnvSpec,
        policy: &PolicyInCollection<Self>,
    ) -> Result<Self::Trainer, RlError>;
}

/// Type of the policies that a collection of policies with settings `S` holds.
pub type PolicyInCollection<S> =
    <<S as PolicyCollectionSettings>::Trainer as PolicyTrainer>::Policy;
/// Type of the state of a rollout that a policy of a collection with settings `S` collects.
pub(super) type RolloutStateInCollection<S> =
    RolloutState<<PolicyInCollection<S> as Actor>::Memory>;
/// Type of the storage of a rollout in a collection of policies with settings `S`.
pub type RolloutInCollection<S> =
    <<S as PolicyCollectionSettings>::Trainer as PolicyTrainer>::Rollout;

/// Trainer of one policy of a collection: an algorithm with its state.
pub trait PolicyTrainer: Sized + Send + 'static {
    /// Type of the policy that is trained.
    type Policy: MeasureUnitActivity + FeatureExtractor + ExportPolicy + Clone + Send;
    /// Type of the storage of a rollout until it is assigned to a policy.
    type Rollout: ExperienceBuffer<Self::Policy> + Rollout + Send;

    /// Prepares `rollout` before the policy of this training collects it. The default does nothing.
    fn prepare_rollout(&self, _rollout: &mut Self::Rollout) {}

    /// Prepares a rollout that another policy collected for training `policy`.
    ///
    /// # Errors
    /// Errors of the policy.
    fn adapt_rollout(policy: &mut Self::Policy, rollout: &mut Self::Rollout)
    -> Result<(), RlError>;

    /// Trains `policy` on the rollouts that were collected since the last call; returns the values
    /// to log.
    ///
    /// # Errors
    /// Errors of the algorithm.
    fn learn(
        &mut self,
        policy: &mut Self::Policy,
        rollout: &mut Self::Rollout,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError>;

    /// Returns the state of the training algorithm, as named arrays and counters.
    fn algorithm_state(&self) -> AlgorithmState<'_>;

    /// Restores the state of the algorithm that [`PolicyTrainer::algorithm_state`] returned.
    ///
    /// # Errors
    /// A state of another algorithm or network.
    fn restore_algorithm(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError>;

    /// Returns the arrays besides [`PolicyTrainer::algorithm_state`] that a checkpoint needs, under
    /// names that begin with `prefix`.
    fn extra_tensors(&self, _prefix: &str) -> Vec<CheckpointTensor> {
        Vec::new()
    }

    /// Restores the arrays that [`PolicyTrainer::extra_tensors`] returned.
    ///
    /// # Errors
    /// Arrays that are missing or do not fit.
    fn restore_extra_tensors(
        &mut self,
        _file: &TensorFile<'_>,
        _prefix: &str,
    ) -> Result<(), LearnerError> {
        Ok(())
    }
}

/// Settings that every collection of policies has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommonSettings {
    /// Rule that chooses the policy that a rollout belongs to.
    pub grouping: GroupingSettings,
    /// Number of frames at the start of each episode by which a rollout is assigned to a policy.
    pub first_frames: usize,
    /// Number of decisions of one rollout, all environments together.
    pub rollout_steps: usize,
    /// Number of episodes whose first frames are kept for each policy; `None` keeps all of them.
    pub buffer_episodes: Option<usize>,
    /// Treatment of a rollout that is assigned to a policy other than the one that collected it.
    pub handover: ReassignedRolloutHandling,
    /// Initial parameters of a new policy.
    pub new_policy: NewPolicyInit,
    /// Seed of the learner's random numbers.
    pub seed: u64,
}

impl CommonSettings {
    /// Returns the largest number of episodes whose first frames a policy keeps.
    pub(super) fn buffer_capacity(&self) -> usize {
        self.buffer_episodes.unwrap_or(usize::MAX)
    }

    /// Returns the number of decisions of each environment in a rollout, after checking that the
    /// settings fit the environments and each other. A buffer must hold `min_episodes` for the
    /// grouping.
    pub(super) fn steps_per_env(
        &self,
        spec: &EnvSpec,
        min_episodes: usize,
    ) -> Result<usize, LearnerError> {
        let refuse =
            |name, value: usize, expected| Err(LearnerError::invalid(name, value, expected));
        if self.first_frames == 0 {
            return refuse("first_frames", 0, "at least 1 frame");
        }
        if let Some(episodes) = self.buffer_episodes
            && episodes < min_episodes
        {
            let expected = "at least the min_episodes of the grouping";
            return refuse("buffer_episodes", episodes, expected);
        }
        if spec.num_envs == 0 || !self.rollout_steps.is_multiple_of(spec.num_envs) {
            let expected = "a multiple of the number of environments";
            return refuse("rollout_steps", self.rollout_steps, expected);
        }
        let steps = self.rollout_steps / spec.num_envs;
        if steps < self.first_frames {
            let expected = "at least first_frames decisions in every environment";
            return refuse("rollout_steps", self.rollout_steps, expected);
        }
        Ok(steps)
    }
}

/// Treatment of a rollout that is assigned to a policy other than the one that collected it. The
/// paper's Algorithm 1 updates the assigned policy with it and does not say how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReassignedRolloutHandling {
    /// New rollout: the assigned policy collects it and learns from it. Of the old rollout, only
    /// the first frames are kept, in its buffer. The decisions of both rollouts count.
    #[default]
    CollectAgain,
    /// Same rollout: the assigned policy learns from it with its own log-probabilities and values,
    /// unless it shows two task groups. See
    /// [`RolloutBuffer::reevaluate`](rl::RolloutBuffer::reevaluate).
    Reuse,
}

/// Initial parameters of a new policy; its optimiser is fresh in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NewPolicyInit {
    /// Random parameters, as in the paper.
    #[default]
    Random,
    /// Copy of the parameters of the nearest policy, those of its exploration noise included.
    Copy,
}

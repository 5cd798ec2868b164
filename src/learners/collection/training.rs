//! What differs between collections: how one policy learns from a rollout.

use rand_chacha::ChaCha8Rng;
use rl::{AlgorithmState, Experience, Features, Plain, RlError, Units};

use crate::error::CoversError;
use crate::learners::tensor_file::{Tensor, TensorFile};

use super::first_frames::Rollout;

/// The training of one policy of a collection: an algorithm with its state.
pub trait Training: Sized + Send + 'static {
    /// What is trained.
    type Policy: Units + Features + Plain + Clone + Send;
    /// What a rollout is kept in until it is known whose it is.
    type Rollout: Experience<Self::Policy> + Rollout + Send;

    /// Prepares `rollout` for being collected with this policy.
    fn prepare(&self, _rollout: &mut Self::Rollout) {}

    /// Lets `policy` take a rollout that another one collected.
    ///
    /// # Errors
    /// What the policy says.
    fn take_over(policy: &mut Self::Policy, rollout: &mut Self::Rollout) -> Result<(), RlError>;

    /// Improves `policy` by what was collected since the last call; returns what is logged.
    ///
    /// # Errors
    /// What the algorithm says.
    fn learn(
        &mut self,
        policy: &mut Self::Policy,
        rollout: &mut Self::Rollout,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError>;

    /// The state of the algorithm.
    fn state(&self) -> AlgorithmState<'_>;

    /// Goes on from a state that [`Training::state`] gave.
    ///
    /// # Errors
    /// A state of another algorithm or network.
    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError>;

    /// What else the next update depends on, under names that begin with `prefix`.
    fn memory(&self, _prefix: &str) -> Vec<Tensor> {
        Vec::new()
    }

    /// Takes back what [`Training::memory`] gave.
    ///
    /// # Errors
    /// Arrays that are missing or do not fit.
    fn recall(&mut self, _file: &TensorFile<'_>, _prefix: &str) -> Result<(), CoversError> {
        Ok(())
    }
}

//! What rollout collection, evaluation and policy assignment ask of a policy.

use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::RlError;

/// What a policy decided for N observations.
#[derive(Clone, Debug, PartialEq)]
pub struct Decisions {
    /// Sampled actions `[N, A]` in their natural order, not clipped.
    pub actions: Vec<f32>,
    /// Log-probability densities of the actions, `[N]`, in nats.
    pub log_probs: Vec<f32>,
    /// Values V(s) `[N]`: expected discounted sums of rewards.
    pub values: Vec<f32>,
}

impl Decisions {
    /// Zeros for the environments of `spec`.
    pub fn new(spec: &EnvSpec) -> Self {
        let n = spec.num_envs;
        Self {
            actions: vec![0.0; n * spec.action.len()],
            log_probs: vec![0.0; n],
            values: vec![0.0; n],
        }
    }
}

/// A stochastic policy with a value function and features. N, the number of observations, may differ from call to call.
///
/// The contract of an equivariant policy, for every group element g: the mean action of g s is g applied to the mean
/// action of s; standard deviation, value and features are the same for s and g s.
pub trait Policy {
    /// F, the length of the feature vector of one observation.
    fn feature_dim(&self) -> usize;

    /// Samples actions `[N, A]`, with their log-probabilities and the values of the observations.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn act(
        &mut self,
        observations: &Observations,
        rng: &mut ChaCha8Rng,
        out: &mut Decisions,
    ) -> Result<(), RlError>;

    /// Writes the log-probabilities `[N]` of the actions `[N, A]` that `decisions` holds, and the values `[N]` of the
    /// observations.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn assess(
        &mut self,
        observations: &Observations,
        decisions: &mut Decisions,
    ) -> Result<(), RlError>;

    /// Writes the means of the action distribution, `[N, A]`: what an evaluation executes.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn mean_actions(&mut self, observations: &Observations, out: &mut [f32])
    -> Result<(), RlError>;

    /// Writes the values V(s), `[N]`.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn values(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError>;

    /// Writes the group-invariant features `[N, F]`, which policy assignment compares.
    ///
    /// # Errors
    /// [`RlError::Shape`] when an array does not fit.
    fn features(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError>;
}

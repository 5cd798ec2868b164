//! Interfaces of policies for collection, evaluation and assignment. Acting, state values and
//! features are separate traits, so a policy implements only those that it is used for.

use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_all_finite, check_len, check_rows_finite};

/// Recurrent state of an actor for the running episodes of N environments.
pub trait ActorMemory {
    /// Forgets the running episode of environment `env`, in 0..N, whose next observation starts a
    /// new episode.
    fn forget_episode(&mut self, env: usize);

    /// Records the step of environment `env` that followed the actor's last decision: the executed
    /// action `[A]`, which may differ from the decision, and its reward. Called before
    /// [`ActorMemory::forget_episode`] if the step ended the episode.
    fn remember_step(&mut self, _env: usize, _action: &[f32], _reward: f32) {}
}

/// The memory of an actor that decides from the observation alone.
impl ActorMemory for () {
    fn forget_episode(&mut self, _: usize) {}
}

/// A policy that chooses actions `[N, A]` for N environments, A components each in the
/// environment's order: any finite numbers.
///
/// Every call is one step of N environments: `observations` are those of all environments, and
/// `memory` is carried from step to step. With the memory `()`, N may differ from call to call.
///
/// The contract of an equivariant actor, for every group element g: the mean action of g s is g
/// applied to the mean action of s, and the standard deviation is the same for s and g s.
pub trait Actor {
    /// State kept from step to step: `()` if the actor decides from the observation alone.
    type Memory: ActorMemory;

    /// Returns the memory for `envs` environments (N) in which no episode has begun.
    fn new_memory(&self, envs: usize) -> Self::Memory;

    /// Samples actions `[N, A]` from the action distribution, as
    /// [`collect_experience`](crate::collect_experience) executes them.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut Self::Memory,
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError>;

    /// Writes the means of the action distribution, `[N, A]`, as
    /// [`evaluate_policy`](crate::evaluate_policy) executes them.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn mean_actions(
        &mut self,
        observations: &Observations,
        memory: &mut Self::Memory,
        out: &mut [f32],
    ) -> Result<(), RlError>;
}

/// A policy with a state-value function V. The contract of an equivariant policy, for every group
/// element g and state s: V(g s) = V(s).
pub trait ValueFunction {
    /// Writes the state values V(s) of N observations, `[N]`: expected discounted sums of rewards.
    /// N may be any number.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn values(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError>;
}

/// A policy that maps observations to feature vectors, which the assignment of rollouts to policies
/// compares. The contract of an equivariant policy: g s and s have equal features, for every group
/// element g and observation s.
pub trait FeatureExtractor {
    /// Returns F, the length of the feature vector of one observation.
    fn feature_dim(&self) -> usize;

    /// Writes the feature vectors of N observations, `[N, F]`, to `out`. N may be any number.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn features(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError>;
}

/// A policy for on-policy collection, which gives an action, its log-probability and the state
/// value in one call, so that a network whose actor and critic share an encoder runs the encoder
/// once.
pub trait OnPolicyActor: Actor + ValueFunction {
    /// Writes the actions that follow from the standard normal `noise` `[N, A]`, their
    /// log-probabilities and the state values. The noise is the only source of randomness: equal
    /// noise gives equal actions. With independent noise, actions are distributed like those of
    /// [`Actor::act`].
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn decide(
        &mut self,
        observations: &Observations,
        memory: &mut Self::Memory,
        noise: &[f32],
        out: &mut Decisions,
    ) -> Result<(), RlError>;
}

/// A policy that can evaluate actions another policy took, like Stable-Baselines3's
/// `evaluate_actions`. Only for policies without a memory, since recorded observations do not
/// contain one.
pub trait EvaluateActions: ValueFunction {
    /// Writes the log-probabilities `[N]` of the actions `[N, A]` that `decisions` holds, and the
    /// state values `[N]` of the observations.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    fn evaluate_actions(
        &mut self,
        observations: &Observations,
        decisions: &mut Decisions,
    ) -> Result<(), RlError>;
}

/// Actions that a policy sampled for N observations, with log-probabilities and state values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decisions {
    /// Sampled actions `[N, A]` in the environment's order, not clipped.
    pub actions: Vec<f32>,
    /// Log-probability densities of the actions, `[N]`, in nats.
    pub log_probs: Vec<f32>,
    /// State values V(s) of the observations, `[N]`: expected discounted sums of rewards.
    pub values: Vec<f32>,
}

impl Decisions {
    /// Creates decisions of zeros, one for each environment of `spec`.
    pub fn new(spec: &EnvSpec) -> Self {
        let n = spec.num_envs;
        Self {
            actions: vec![0.0; n * spec.action_irreps.len()],
            log_probs: vec![0.0; n],
            values: vec![0.0; n],
        }
    }

    /// Checks that every array holds `samples` decisions for the actions of `spec`.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] names the array, what it holds and what it should hold.
    pub fn check_lengths(&self, spec: &EnvSpec, samples: usize) -> Result<(), RlError> {
        let width = spec.action_irreps.len();
        check_len("actions", "[N, A]", self.actions.len(), samples * width)?;
        check_len("log_probs", "[N]", self.log_probs.len(), samples)?;
        check_len("values", "[N]", self.values.len(), samples)
    }

    /// Rejects decisions with infinities or NaN.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] names the array's quantity.
    pub fn check_finite(&self) -> Result<(), RlError> {
        let width = (self.actions.len() / self.values.len().max(1)).max(1);
        check_rows_finite("an action", &self.actions, width)?;
        check_all_finite("a log-probability", &self.log_probs)?;
        check_all_finite("a value", &self.values)
    }
}

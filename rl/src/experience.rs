//! What collection fills and an algorithm consumes.

use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations, Transition};
use crate::error::RlError;
use crate::policy::Actor;

/// Experience with an actor: a rollout that an update uses up, or a replay that grows.
///
/// [`collect`](crate::collect) calls `begin`; then, [`Experience::steps`] times, `decide`, one step
/// of the environments and `record`; then `end`.
pub trait Experience<A: Actor> {
    /// Steps of every environment in one collection, at least 1.
    fn steps(&self) -> usize;

    /// Prepares for steps of the environments of `spec`. A rollout forgets the one before, a replay
    /// keeps what it holds.
    ///
    /// # Errors
    /// [`RlError::SpecMismatch`] for other environments than it was made for.
    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError>;

    /// Lets `actor` choose, keeps what the algorithm needs to know of the choice, and returns the
    /// actions `[N, A]`.
    ///
    /// # Errors
    /// What the actor says.
    fn decide(
        &mut self,
        actor: &mut A,
        observations: &Observations,
        memory: &mut A::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError>;

    /// Keeps the step from `observations` that the last actions led to.
    ///
    /// # Errors
    /// What the actor says, or an array that does not fit.
    fn record(
        &mut self,
        actor: &mut A,
        observations: &Observations,
        transition: &Transition,
    ) -> Result<(), RlError>;

    /// Ends the collection; `last` is what the actor would have acted on next.
    ///
    /// # Errors
    /// What the actor says, or an array that does not fit.
    fn end(&mut self, actor: &mut A, last: &Observations) -> Result<(), RlError>;
}

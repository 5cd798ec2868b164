//! What collection fills and an algorithm consumes.

use rand::RngExt;
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

    /// Room for the actions `[N, A]` of the next step, and whether that step belongs to a warm-up,
    /// in which actions are drawn uniformly from [-1, 1].
    fn choice(&mut self) -> (&mut [f32], bool);

    /// Lets `actor` choose, keeps what the algorithm needs to know of the choice, and returns the
    /// actions `[N, A]`. Unless it is said otherwise, the actions alone are kept; in a warm-up the
    /// actor is asked, too.
    ///
    /// # Errors
    /// What the actor says.
    fn decide(
        &mut self,
        actor: &mut A,
        observations: &Observations,
        memory: &mut A::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        let (actions, warm_up) = self.choice();
        actor.act(observations, memory, rng, actions)?;
        if warm_up {
            actions.fill_with(|| rng.random_range(-1.0..=1.0));
        }
        Ok(actions)
    }

    /// Keeps the step that the last actions led to: `from` what was seen `to` what came of it.
    ///
    /// # Errors
    /// What the actor says, or an array that does not fit.
    fn record(
        &mut self,
        actor: &mut A,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError>;

    /// Ends the collection; `last` is what the actor would have acted on next.
    ///
    /// # Errors
    /// What the actor says, or an array that does not fit.
    fn end(&mut self, _actor: &mut A, _last: &Observations) -> Result<(), RlError> {
        Ok(())
    }
}

//! Actors that see nothing and draw nothing.

use rand_chacha::ChaCha8Rng;
use rl::{Actor, Decisions, Memory, Observations, OnPolicy, RlError, Values};

/// Decides by its memory alone, without noise, and values everything at 0.
pub trait Unseeing {
    type Memory: Memory;

    fn memory(&self, envs: usize) -> Self::Memory;

    /// Writes the actions `[N, A]` of one step.
    fn decide(&self, memory: &mut Self::Memory, out: &mut [f32]);
}

/// What such an actor is to collection and evaluation.
pub struct Acting<U>(pub U);

impl<U: Unseeing> Actor for Acting<U> {
    type Memory = U::Memory;

    fn memory(&self, envs: usize) -> U::Memory {
        self.0.memory(envs)
    }

    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut U::Memory,
        _: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.mean_actions(observations, memory, out)
    }

    fn mean_actions(
        &mut self,
        _: &Observations,
        memory: &mut U::Memory,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.0.decide(memory, out);
        Ok(())
    }
}

impl<U: Unseeing> Values for Acting<U> {
    fn values(&mut self, _: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        out.fill(0.0);
        Ok(())
    }
}

impl<U: Unseeing> OnPolicy for Acting<U> {
    fn decide(
        &mut self,
        observations: &Observations,
        memory: &mut U::Memory,
        _: &[f32],
        out: &mut Decisions,
    ) -> Result<(), RlError> {
        self.mean_actions(observations, memory, &mut out.actions)?;
        out.log_probs.fill(0.0);
        self.values(observations, &mut out.values)
    }
}

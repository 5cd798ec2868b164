//! How a collection fills the buffer.

use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations, Outcome, Transition};
use crate::error::{RlError, check_len};
use crate::experience::Experience;
use crate::policy::{OnPolicy, Values};

use super::RolloutBuffer;

impl<P: OnPolicy> Experience<P> for RolloutBuffer {
    /// As many as there is room for, also where the last rollout lost its end.
    #[allow(
        clippy::misnamed_getters,
        reason = "`steps` are those of the last rollout"
    )]
    fn steps(&self) -> usize {
        self.capacity
    }

    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.spec.check_same(spec)?;
        check_len("environments", "[N]", spec.num_envs, self.spec.num_envs)?;
        self.clear();
        self.noise.restart();
        Ok(())
    }

    fn choice(&mut self) -> (&mut [f32], bool) {
        (&mut self.step_decisions.actions, false)
    }

    /// With the log-probabilities and the values.
    fn decide(
        &mut self,
        policy: &mut P,
        observations: &Observations,
        memory: &mut P::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        let noise = self.noise.draw(rng);
        policy.decide(observations, memory, noise, &mut self.step_decisions)?;
        Ok(&self.step_decisions.actions)
    }

    fn record(
        &mut self,
        policy: &mut P,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError> {
        value_truncated(policy, to, &mut self.step_final_values)?;
        // lent out, since a push borrows all of the buffer
        let decisions = std::mem::take(&mut self.step_decisions);
        let final_values = std::mem::take(&mut self.step_final_values);
        let result = self.push(from, &decisions, to, &final_values);
        (self.step_decisions, self.step_final_values) = (decisions, final_values);
        result?;
        let ended = |&(_, outcome): &(usize, &Outcome)| outcome.ended();
        let ends = to.outcomes.iter().enumerate().filter(ended);
        ends.for_each(|(env, _)| self.noise.forget(env));
        Ok(())
    }

    fn end(&mut self, policy: &mut P, last: &Observations) -> Result<(), RlError> {
        let mut values = vec![0.0; self.spec.num_envs];
        policy.values(last, &mut values)?;
        self.finish(last, &values)
    }
}

/// Asks for the values of the final observations where a truncation will bootstrap them.
fn value_truncated<P: Values>(
    policy: &mut P,
    transition: &Transition,
    out: &mut [f32],
) -> Result<(), RlError> {
    if transition.outcomes.contains(&Outcome::Truncated) {
        policy.values(&transition.final_observations, out)?;
    }
    Ok(())
}

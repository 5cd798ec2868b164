//! Actors that ignore observations and draw no noise, and environments whose episodes differ in
//! length.

use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorMemory, BoxedEnvError, Decisions, EnvSpec, Observations, OnPolicyActor, RlError,
    StepOutcome, Transition, ValueFunction, VectorEnv,
};
use symmetry::Irrep;

/// An actor that ignores observations, draws no noise and values everything at 0: `decide` writes
/// the actions `[N, A]` of one step from the memory alone.
pub struct BlindActor<F, G> {
    pub new_memory: F,
    pub decide: G,
}

impl<M, F, G> Actor for BlindActor<F, G>
where
    M: ActorMemory,
    F: Fn(usize) -> M,
    G: Fn(&mut M, &mut [f32]),
{
    type Memory = M;

    fn new_memory(&self, envs: usize) -> M {
        (self.new_memory)(envs)
    }

    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut M,
        _: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.mean_actions(observations, memory, out)
    }

    fn mean_actions(
        &mut self,
        _: &Observations,
        memory: &mut M,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        (self.decide)(memory, out);
        Ok(())
    }
}

impl<F, G> ValueFunction for BlindActor<F, G> {
    fn values(&mut self, _: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        out.fill(0.0);
        Ok(())
    }
}

impl<M, F, G> OnPolicyActor for BlindActor<F, G>
where
    M: ActorMemory,
    F: Fn(usize) -> M,
    G: Fn(&mut M, &mut [f32]),
{
    fn decide(
        &mut self,
        observations: &Observations,
        memory: &mut M,
        _: &[f32],
        out: &mut Decisions,
    ) -> Result<(), RlError> {
        self.mean_actions(observations, memory, &mut out.actions)?;
        out.log_probs.fill(0.0);
        self.values(observations, &mut out.values)
    }
}

/// Environment n ends its episodes after `lengths[n]` steps, by turns with a termination and a
/// time-out. The reward is 1 where an action says how many steps of the episode were taken before,
/// and 0 elsewhere. Pictures and vectors are all zero, so only a memory can tell. A step fails the
/// test unless there is a finite action for every environment.
pub struct Ages {
    spec: EnvSpec,
    lengths: Vec<usize>,
    ages: Vec<usize>,
}

impl Ages {
    pub fn new(lengths: &[usize]) -> Self {
        Self {
            spec: EnvSpec {
                num_envs: lengths.len(),
                image_shape: [2, 3, 1],
                vector_irreps: vec![Irrep::Trivial],
                action_irreps: vec![Irrep::Trivial],
                choices: vec![],
            },
            lengths: lengths.to_vec(),
            ages: vec![0; lengths.len()],
        }
    }
}

impl VectorEnv for Ages {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        self.lengths.iter().max().copied()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.ages.fill(0);
        *out = Observations::new(&self.spec);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        let right = actions.len() == self.ages.len() && actions.iter().all(|a| a.is_finite());
        assert!(right, "the environment sees {actions:?}");
        *out = Transition::new(&self.spec);
        for (n, age) in self.ages.iter_mut().enumerate() {
            out.rewards[n] = f32::from(u8::from(actions[n] == *age as f32));
            *age += 1;
            if *age == self.lengths[n] {
                out.outcomes[n] = [StepOutcome::Truncated, StepOutcome::Terminated][n % 2];
                *age = 0;
            }
        }
        Ok(())
    }
}

//! Environments whose episodes differ in length, for actors that remember.

use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};
use symmetry::Irrep;

/// Environment n ends its episodes after `lengths[n]` steps, by turns with a termination and a
/// time-out. The reward is 1 where an action says how many steps of the episode were taken before,
/// and 0 elsewhere. Pictures and vectors are all zero, so only a memory can tell.
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
                image: [2, 3, 1],
                vector: vec![Irrep::Trivial],
                action: vec![Irrep::Trivial],
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

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        self.ages.fill(0);
        *out = Observations::new(&self.spec);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        *out = Transition::new(&self.spec);
        for (n, age) in self.ages.iter_mut().enumerate() {
            out.rewards[n] = f32::from(u8::from(actions[n] == *age as f32));
            *age += 1;
            if *age == self.lengths[n] {
                out.outcomes[n] = [Outcome::Truncated, Outcome::Terminated][n % 2];
                *age = 0;
            }
        }
        Ok(())
    }
}

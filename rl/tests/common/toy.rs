//! Environments of toy tasks, which step together.

use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};
use symmetry::Irrep;

/// A task in N environments, whose episodes all last as long.
pub trait Toy {
    /// Decisions an episode lasts.
    const EPISODE: usize;

    /// Begins an episode in environment `n`.
    fn restart(&mut self, n: usize);

    /// Writes what environment `n` shows into row `n`.
    fn observe(&self, n: usize, out: &mut Observations);

    /// Takes an action `[A]` in environment `n`; returns the reward, and whether the success
    /// condition holds.
    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool);
}

/// The environments of a task.
#[derive(Clone)]
pub struct Toys<T> {
    spec: EnvSpec,
    task: T,
    ages: Vec<usize>,
}

impl<T: Toy> Toys<T> {
    pub fn of(task: T, spec: EnvSpec) -> Self {
        let ages = vec![0; spec.num_envs];
        Self { spec, task, ages }
    }

    /// Declares other irreps than the task has.
    pub fn declaring(mut self, vector: &[Irrep], action: &[Irrep]) -> Self {
        self.spec.vector_irreps = vector.to_vec();
        self.spec.action_irreps = action.to_vec();
        self
    }

    fn restart(&mut self, n: usize) {
        self.task.restart(n);
        self.ages[n] = 0;
    }
}

impl<T: Toy> VectorEnv for Toys<T> {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(T::EPISODE)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        for n in 0..self.spec.num_envs {
            self.restart(n);
            self.task.observe(n, out);
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        let actions = actions.chunks_exact(self.spec.action_irreps.len());
        for (n, action) in actions.enumerate() {
            (out.rewards[n], out.success[n]) = self.task.act(n, action);
            out.success_at_end[n] = out.success[n];
            self.ages[n] += 1;
            let over = self.ages[n] == T::EPISODE;
            out.outcomes[n] = [StepOutcome::Running, StepOutcome::Truncated][usize::from(over)];
            if over {
                self.task.observe(n, &mut out.final_observations);
                self.restart(n);
            }
            self.task.observe(n, &mut out.observations);
        }
        Ok(())
    }
}

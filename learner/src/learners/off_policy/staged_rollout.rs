//! Rollout that is stored until it is assigned to a policy and its replay buffer.

use rl::{
    Actor, EnvSpec, ExperienceBuffer, Observations, ReplayBuffer, RlError, SacPolicy, Transition,
};

use crate::learners::collection::{Rollout, SingleEnvStep};

/// Rollouts that wait until they are assigned to a policy and its replay buffer
/// ([`StagedRollout::commit_to`]). Each begins with a reset of the environments.
pub struct StagedRollout {
    spec: EnvSpec,
    steps: usize,
    /// Number of next decisions whose actions are uniformly random.
    uniform: u64,
    rollouts: Vec<Vec<Step>>,
    /// Actions of the step that is being collected, `[number of environments, action dimensions]`.
    actions: Vec<f32>,
}

struct Step {
    observations: Observations,
    actions: Vec<f32>,
    transition: Transition,
}

impl StagedRollout {
    /// Creates empty storage for rollouts of `steps` steps in every environment.
    pub fn new(spec: &EnvSpec, steps: usize) -> Self {
        Self { spec: spec.clone(), steps, uniform: 0, rollouts: Vec::new(), actions: Vec::new() }
    }

    /// Makes the actions of the next `decisions` decisions, all environments together, uniformly
    /// random in [-1, 1] instead of the policy's.
    pub fn schedule_uniform_actions(&mut self, decisions: u64) {
        self.uniform = decisions;
    }

    /// Moves all stored rollouts into `replay`, the buffer of the policy that they belong to.
    pub fn commit_to(&mut self, replay: &mut ReplayBuffer) -> Result<(), RlError> {
        for steps in self.rollouts.drain(..) {
            // each rollout began with a reset, which ends the running episodes of the replay
            replay.cut_running_episodes();
            ExperienceBuffer::<SacPolicy>::begin(replay, &self.spec)?;
            for step in steps {
                replay.push(&step.observations, &step.actions, &step.transition)?;
            }
        }
        Ok(())
    }

    /// Returns the steps of the last rollout.
    fn last(&self) -> &[Step] {
        self.rollouts.last().map_or(&[], Vec::as_slice)
    }
}

impl<A: Actor> ExperienceBuffer<A> for StagedRollout {
    fn steps_per_env(&self) -> usize {
        self.steps
    }

    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.spec = spec.clone();
        self.actions.resize(spec.num_envs * spec.action_irreps.len(), 0.0);
        self.rollouts.push(Vec::with_capacity(self.steps));
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        let warm_up = self.uniform > 0;
        self.uniform = self.uniform.saturating_sub(self.spec.num_envs as u64);
        (&mut self.actions, warm_up)
    }

    fn record(&mut self, _: &mut A, from: &Observations, to: &Transition) -> Result<(), RlError> {
        let step = Step {
            observations: from.clone(),
            actions: self.actions.clone(),
            transition: to.clone(),
        };
        if let Some(rollout) = self.rollouts.last_mut() {
            rollout.push(step);
        }
        Ok(())
    }
}

impl Rollout for StagedRollout {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn num_steps(&self) -> usize {
        self.last().len()
    }

    fn step(&self, step: usize, env: usize) -> SingleEnvStep<'_> {
        let (step, len) = (&self.last()[step], self.spec.action_irreps.len());
        let (image, vector) = step.observations.image_and_vector(&self.spec, env);
        SingleEnvStep {
            image,
            vector,
            action: &step.actions[env * len..(env + 1) * len],
            reward: step.transition.rewards[env],
            outcome: step.transition.outcomes[env],
        }
    }

    fn truncate(&mut self, steps: usize) -> Result<(), RlError> {
        if let Some(last) = self.rollouts.last_mut() {
            last.truncate(steps);
        }
        Ok(())
    }

    fn keep_latest(&mut self, rollouts: usize) {
        let too_many = self.rollouts.len().saturating_sub(rollouts);
        self.rollouts.drain(..too_many);
    }
}

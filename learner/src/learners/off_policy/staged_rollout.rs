//! Rollout that is stored until it is assigned to a policy and its replay buffer.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActionNoise, EnvSpec, ExperienceBuffer, Observations, ReplayBuffer, RlError, SacActorMemory,
    SacPolicy, Transition,
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
    /// Exploration noise of the actions.
    noise: ActionNoise,
}

struct Step {
    observations: Observations,
    actions: Vec<f32>,
    transition: Transition,
}

impl StagedRollout {
    /// Creates empty storage for rollouts of `steps` steps in every environment, whose exploration
    /// noise has the correlation `noise_correlation` from step to step.
    ///
    /// # Errors
    /// Errors of [`ActionNoise::set_correlation`].
    pub fn new(spec: &EnvSpec, steps: usize, noise_correlation: f32) -> Result<Self, RlError> {
        let width = spec.action_irreps.len();
        let mut noise = ActionNoise::independent(spec.num_envs, width);
        noise.set_correlation(noise_correlation)?;
        let actions = vec![0.0; spec.num_envs * width];
        let (spec, rollouts) = (spec.clone(), Vec::new());
        Ok(Self { spec, steps, uniform: 0, rollouts, actions, noise })
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

impl ExperienceBuffer<SacPolicy> for StagedRollout {
    fn steps_per_env(&self) -> usize {
        self.steps
    }

    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.spec.check_compatible(spec)?;
        if spec.num_envs != self.spec.num_envs {
            return Err(RlError::ShapeMismatch {
                what: "environments",
                shape: "[N]",
                got: spec.num_envs,
                expected: self.spec.num_envs,
            });
        }
        self.noise.restart_all();
        self.rollouts.push(Vec::with_capacity(self.steps));
        Ok(())
    }

    fn action_buffer(&mut self) -> (&mut [f32], bool) {
        let warm_up = self.uniform > 0;
        self.uniform = self.uniform.saturating_sub(self.spec.num_envs as u64);
        (&mut self.actions, warm_up)
    }

    /// Samples actions from `policy` with the exploration noise, or uniformly in the warm-up.
    fn decide(
        &mut self,
        policy: &mut SacPolicy,
        observations: &Observations,
        memory: &mut SacActorMemory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        let noise = self.noise.sample(rng);
        // in a warm-up, too: a recurrent actor's memory needs every observation
        policy.act_with_noise(observations, memory, noise, &mut self.actions)?;
        let (actions, warm_up) = ExperienceBuffer::<SacPolicy>::action_buffer(self);
        if warm_up {
            actions.fill_with(|| rng.random_range(-1.0..=1.0));
        }
        Ok(actions)
    }

    fn record(
        &mut self,
        _: &mut SacPolicy,
        from: &Observations,
        to: &Transition,
    ) -> Result<(), RlError> {
        let step = Step {
            observations: from.clone(),
            actions: self.actions.clone(),
            transition: to.clone(),
        };
        if let Some(rollout) = self.rollouts.last_mut() {
            rollout.push(step);
        }
        self.noise.restart_ended(&to.outcomes);
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

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rl::{EncoderSettings, NetworkSettings, StepOutcome};
    use symmetry::{Group, Irrep};

    use super::*;

    const ENVS: usize = 4000;

    /// Returns the correlation of two rows of numbers with mean 0.
    fn correlation(one: &[f32], other: &[f32]) -> f64 {
        let product =
            |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum() };
        product(one, other) / (product(one, one) * product(other, other)).sqrt()
    }

    /// All observations are equal, so that actions differ by their noise alone. The first half of
    /// the episodes ends with every step.
    #[test]
    fn the_noise_of_an_episode_goes_on_and_that_of_the_next_begins_afresh() {
        let spec = EnvSpec {
            num_envs: ENVS,
            image_shape: EnvSpec::NO_IMAGE,
            vector_irreps: vec![Irrep::Trivial],
            action_irreps: vec![Irrep::Trivial],
            choices: Vec::new(),
        };
        let network = NetworkSettings {
            group: Group::C1,
            encoder: EncoderSettings::Blind,
            ..NetworkSettings::default()
        };
        let mut policy = SacPolicy::new(&network, None, &spec, 0).unwrap();
        let mut memory = rl::Actor::new_memory(&policy, ENVS);
        let (seen, mut transition) = (Observations::new(&spec), Transition::new(&spec));
        transition.outcomes[..ENVS / 2].fill(StepOutcome::Truncated);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut rollout = StagedRollout::new(&spec, 2, 0.8).unwrap();
        rollout.begin(&spec).unwrap();
        let mut actions = Vec::new();
        for step in 0..3 {
            if step == 2 {
                rollout.begin(&spec).unwrap();
            }
            let decided = rollout.decide(&mut policy, &seen, &mut memory, &mut rng).unwrap();
            // the noise before the policy's tanh, but for its scale
            let raw: Vec<f32> = decided.iter().map(|action| action.atanh()).collect();
            let mean = raw.iter().sum::<f32>() / ENVS as f32;
            actions.push(raw.iter().map(|noise| noise - mean).collect::<Vec<f32>>());
            rollout.record(&mut policy, &seen, &transition).unwrap();
        }
        let halves = [0..ENVS / 2, ENVS / 2..ENVS];
        let [ended, running] =
            halves.map(|half| correlation(&actions[0][half.clone()], &actions[1][half]));
        let restarted = correlation(&actions[1], &actions[2]);
        // five standard errors of 2000 pairs
        assert!(ended.abs() < 0.11 && restarted.abs() < 0.11, "{ended} {restarted}");
        assert!((running - 0.8).abs() < 0.05, "{running}");
        let fewer = EnvSpec { num_envs: 1, ..spec.clone() };
        assert!(rollout.begin(&fewer).unwrap_err().to_string().contains("environments"));
        assert!(StagedRollout::new(&spec, 2, 1.0).is_err());
    }
}

//! Environments of random observations: the time of an update does not depend on its input.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};

/// Number of steps in an episode of random observations.
pub const HORIZON: usize = 50;

/// Returns the spec of [`RandomEnv`]: twenty environments with images of 48 x 48 pixels.
pub fn random_env_spec() -> EnvSpec {
    EnvSpec {
        num_envs: 20,
        image_shape: [48, 48, envs::ExtraViews::First.num_total_channels()],
        vector_irreps: envs::VECTOR_OBSERVATION_IRREPS.to_vec(),
        action_irreps: envs::ACTION_IRREPS.to_vec(),
        choices: vec![],
    }
}

/// Environments with random observations and rewards, which ignore actions.
pub struct RandomEnv {
    spec: EnvSpec,
    steps: usize,
    rng: ChaCha8Rng,
}

impl RandomEnv {
    pub fn new() -> Self {
        Self { spec: random_env_spec(), steps: 0, rng: ChaCha8Rng::seed_from_u64(0) }
    }
}

impl VectorEnv for RandomEnv {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(HORIZON)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.steps = 0;
        out.images.fill_with(|| self.rng.random());
        out.vectors.fill_with(|| self.rng.random_range(-1.0..1.0));
        Ok(())
    }

    fn step(&mut self, _actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        let steps = self.steps + 1;
        self.reset(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        out.rewards.fill_with(|| self.rng.random());
        let ended = steps == HORIZON;
        let outcome = [StepOutcome::Running, StepOutcome::Truncated][usize::from(ended)];
        out.outcomes.fill(outcome);
        self.steps = if ended { 0 } else { steps };
        Ok(())
    }
}

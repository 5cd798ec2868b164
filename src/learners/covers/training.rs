//! Training by proximal policy optimisation.

use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, AlgorithmState, EnvSpec, Metrics, Ppo, RlError, RolloutBuffer,
};
use symmetry::Group;

use crate::learners::collection::{Collection, Training};

use super::settings::CoversSettings;

/// The learner of the paper: a growing collection of policies, trained by PPO.
pub type Covers = Collection<PpoTraining>;

/// Learns from one rollout after the other and keeps none.
pub struct PpoTraining {
    ppo: Ppo,
    augmentation: Group,
}

impl Training for PpoTraining {
    type Settings = CoversSettings;
    type Policy = ActorCriticPolicy;
    type Rollout = RolloutBuffer;

    fn policy(
        settings: &CoversSettings,
        spec: &EnvSpec,
        seed: u64,
    ) -> Result<ActorCriticPolicy, RlError> {
        ActorCriticPolicy::new(&settings.network, spec, seed)
    }

    fn with_params(
        settings: &CoversSettings,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<ActorCriticPolicy, RlError> {
        ActorCriticPolicy::with_params(&settings.network, spec, params)
    }

    fn params(policy: &ActorCriticPolicy) -> &[f32] {
        policy.params()
    }

    fn new(
        settings: &CoversSettings,
        _: &EnvSpec,
        policy: &ActorCriticPolicy,
    ) -> Result<Self, RlError> {
        Ok(Self {
            ppo: Ppo::new(settings.ppo.clone(), policy)?,
            augmentation: settings.augmentation,
        })
    }

    fn rollout(spec: &EnvSpec, steps: usize) -> Result<RolloutBuffer, RlError> {
        RolloutBuffer::new(spec, steps)
    }

    fn take_over(
        policy: &mut ActorCriticPolicy,
        rollout: &mut RolloutBuffer,
    ) -> Result<(), RlError> {
        rollout.revalue(policy)
    }

    fn learn(
        &mut self,
        policy: &mut ActorCriticPolicy,
        rollout: &mut RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError> {
        if self.augmentation != Group::C1 {
            rollout.augment(self.augmentation, rng)?;
            rollout.revalue(policy)?;
        }
        Ok(self.ppo.update(policy, rollout, rng)?.metrics())
    }

    fn state(&self) -> AlgorithmState<'_> {
        self.ppo.save()
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        self.ppo.restore(state)
    }
}

//! Training by soft actor-critic.

use rand_chacha::ChaCha8Rng;
use rl::{Algorithm, AlgorithmState, EnvSpec, Metrics, Replay, RlError, Sac, SacPolicy};

use crate::error::CoversError;
use crate::learners::collection::{Collection, Training};
use crate::learners::tensor_file::{Tensor, TensorFile};

use super::memory;
use super::recording::Recording;
use super::settings::OffPolicySettings;

/// A growing collection of policies, or a single one, trained by soft actor-critic.
pub type OffPolicy = Collection<SacTraining>;

/// Keeps the latest steps of one policy's rollouts in a replay and learns from those.
pub struct SacTraining {
    sac: Sac,
    replay: Replay,
    settings: OffPolicySettings,
}

impl Training for SacTraining {
    type Settings = OffPolicySettings;
    type Policy = SacPolicy;
    type Rollout = Recording;

    fn policy(
        settings: &OffPolicySettings,
        spec: &EnvSpec,
        seed: u64,
    ) -> Result<SacPolicy, RlError> {
        SacPolicy::new(&settings.network, settings.context, spec, seed)
    }

    fn with_params(
        settings: &OffPolicySettings,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<SacPolicy, RlError> {
        SacPolicy::with_params(&settings.network, settings.context, spec, params)
    }

    fn params(policy: &SacPolicy) -> &[f32] {
        policy.params()
    }

    fn new(
        settings: &OffPolicySettings,
        spec: &EnvSpec,
        policy: &SacPolicy,
    ) -> Result<Self, RlError> {
        Ok(Self {
            sac: Sac::new(settings.sac.clone(), policy)?,
            replay: Replay::new(settings.replay(spec), spec)?,
            settings: settings.clone(),
        })
    }

    fn rollout(spec: &EnvSpec, steps: usize) -> Result<Recording, RlError> {
        spec.check_rollout(steps)?;
        Ok(Recording::new(spec, steps))
    }

    fn prepare(&self, rollout: &mut Recording) {
        let recorded = self.replay.recorded();
        rollout.warm_up(self.settings.warm_up.saturating_sub(recorded));
    }

    /// A replay takes steps of any policy as they are.
    fn take_over(_: &mut SacPolicy, _: &mut Recording) -> Result<(), RlError> {
        Ok(())
    }

    fn learn(
        &mut self,
        policy: &mut SacPolicy,
        rollout: &mut Recording,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError> {
        rollout.pour(&mut self.replay)?;
        self.replay.mark_newest(self.settings.newest_steps);
        Ok(self.sac.update(policy, &self.replay, rng)?.metrics())
    }

    fn state(&self) -> AlgorithmState<'_> {
        self.sac.save()
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        self.sac.restore(state)
    }

    fn memory(&self, prefix: &str) -> Vec<Tensor> {
        memory::tensors(&self.replay, prefix)
    }

    fn recall(&mut self, file: &TensorFile<'_>, prefix: &str) -> Result<(), CoversError> {
        self.replay = memory::read(file, prefix, &self.replay)?;
        Ok(())
    }
}

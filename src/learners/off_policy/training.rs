//! Training by soft actor-critic.

use rand_chacha::ChaCha8Rng;
use rl::{Algorithm, AlgorithmState, Metrics, Replay, RlError, Sac, SacPolicy};

use crate::error::CoversError;
use crate::learners::collection::Training;
use crate::learners::tensor_file::{Tensor, TensorFile};

use super::memory;
use super::recording::Recording;

/// Keeps the latest steps of one policy's rollouts in a replay and learns from those.
pub struct SacTraining {
    pub(super) sac: Sac,
    pub(super) replay: Replay,
    /// As in [`OffPolicySettings`](crate::OffPolicySettings).
    pub(super) warm_up: u64,
    pub(super) newest_steps: u64,
}

impl Training for SacTraining {
    type Policy = SacPolicy;
    type Rollout = Recording;

    fn prepare(&self, rollout: &mut Recording) {
        let recorded = self.replay.recorded();
        rollout.warm_up(self.warm_up.saturating_sub(recorded));
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
        self.replay.mark_newest(self.newest_steps);
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

//! Training by proximal policy optimisation.

use rand_chacha::ChaCha8Rng;
use rl::{ActorCriticPolicy, Algorithm, AlgorithmState, Metrics, Ppo, RlError, RolloutBuffer};
use symmetry::Group;

use crate::learners::collection::Training;

/// Learns from one rollout after the other and keeps none.
pub struct PpoTraining {
    pub(super) ppo: Ppo,
    pub(super) augmentation: Group,
}

impl Training for PpoTraining {
    type Policy = ActorCriticPolicy;
    type Rollout = RolloutBuffer;

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

//! Soft actor-critic on the toy environment.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    EncoderSettings, NetworkSettings, RecurrentContextSettings, ReplayBuffer, ReplaySettings,
    RlError, RolloutState, RolloutStats, Sac, SacActorMemory, SacPolicy, SacSettings, VectorEnv,
    collect_experience,
};

use crate::common::steps::joint;
use crate::common::{EPISODE, PointReach};

pub const ENVS: usize = 5;

pub fn network(encoder: EncoderSettings) -> NetworkSettings {
    joint(encoder, 4)
}

/// A replay that collects whole episodes and draws its actions from the policy after 20 decisions.
pub fn replay_settings() -> ReplaySettings {
    ReplaySettings { capacity: 80, steps: EPISODE, warm_up: 20, still_channels: 0 }
}

pub fn settings() -> SacSettings {
    SacSettings { batch: 20, updates_per_step: 0.1, burn_in: 40, ..SacSettings::default() }
}

/// A training run in the middle of its episodes.
pub struct Run {
    pub env: PointReach,
    pub policy: SacPolicy,
    pub sac: Sac,
    pub replay: ReplayBuffer,
    pub state: RolloutState<SacActorMemory>,
    pub rng: ChaCha8Rng,
}

impl Run {
    pub fn new(
        network: &NetworkSettings,
        context: Option<RecurrentContextSettings>,
        settings: SacSettings,
        replay: ReplaySettings,
    ) -> Self {
        let mut env = PointReach::new(ENVS, 1);
        let policy = SacPolicy::new(network, context, env.spec(), 2).unwrap();
        Self {
            sac: Sac::new(settings, &policy).unwrap(),
            replay: ReplayBuffer::new(replay, env.spec()).unwrap(),
            state: RolloutState::from_env_reset(&mut env, &policy).unwrap(),
            rng: ChaCha8Rng::seed_from_u64(3),
            env,
            policy,
        }
    }

    pub fn collect(&mut self) -> Result<RolloutStats, RlError> {
        collect_experience(
            &mut self.env,
            &mut self.policy,
            &mut self.replay,
            &mut self.state,
            &mut self.rng,
        )
    }
}

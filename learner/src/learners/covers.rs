//! COVERS: a collection of policies that are trained by PPO.
//!
//! With other networks and groupings this learner is each of the paper's PPO baselines. If the
//! paper leaves a gap or this project departs from it, a setting also has the paper's value.

use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, AlgorithmState, EnvSpec, Metrics, NetworkSettings, Ppo,
    PpoSettings, ProcessRanks, RlError, RolloutBuffer,
};
use serde::{Deserialize, Serialize};

use crate::groupings::GroupingSettings;

use super::collection::{
    CommonSettings, NewPolicyInit, PolicyCollection, PolicyCollectionSettings, PolicyTrainer,
    ReassignedRolloutHandling,
};
use super::device::LearningDevice;

/// Learner of the paper: a growing collection of policies, trained by PPO.
pub type CoversLearner = PolicyCollection<CoversSettings>;

/// Settings of [`CoversLearner`].
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CoversSettings {
    /// Sizes and initial values of each policy's network.
    pub network: NetworkSettings,
    /// Settings of the PPO that trains each policy.
    pub ppo: PpoSettings,
    /// Rule that chooses the policy that a rollout belongs to.
    pub grouping: GroupingSettings,
    /// Number of frames at the start of each episode by which a rollout is assigned to a policy:
    /// the paper's `k`. It is 4 there; here a decision holds ten control steps, and only the very
    /// first frame does not depend on the policy that acts.
    pub first_frames: usize,
    /// Number of decisions of one rollout, all environments together: the paper's `N_s`, and its
    /// `N_u`, since both count steps.
    pub rollout_steps: usize,
    /// Correlation of the noise of consecutive actions, in [0, 1). See
    /// [`RolloutBuffer::with_noise_correlation`](rl::RolloutBuffer::with_noise_correlation).
    pub noise_correlation: f32,
    /// Number of episodes whose first frames are kept for each policy, a uniform sample; `None`
    /// keeps all of them. The paper's `B` keeps all, but then memory and transport problems grow
    /// with the number of rollouts.
    pub buffer_episodes: Option<usize>,
    /// Treatment of a rollout that is assigned to a policy other than the one that collected it.
    pub handover: ReassignedRolloutHandling,
    /// Initial parameters of a new policy.
    pub new_policy: NewPolicyInit,
    /// Seed of all random numbers of the learner.
    pub seed: u64,
    /// Device that policies train on; settings files do not store it.
    #[serde(skip)]
    pub device: LearningDevice,
    /// Processes that share the updates; settings files do not store them.
    #[serde(skip)]
    pub ranks: ProcessRanks,
}

impl Default for CoversSettings {
    fn default() -> Self {
        Self {
            network: NetworkSettings::default(),
            ppo: PpoSettings::default(),
            grouping: GroupingSettings::default(),
            first_frames: 1,
            rollout_steps: 500,
            noise_correlation: 0.0,
            buffer_episodes: Some(100),
            handover: ReassignedRolloutHandling::default(),
            new_policy: NewPolicyInit::default(),
            seed: 0,
            device: LearningDevice::default(),
            ranks: ProcessRanks::default(),
        }
    }
}

impl CoversSettings {
    /// Returns the settings of COVERS as published: the paper's method and hyper-parameters, read
    /// literally (section 4, Algorithm 1 and appendix). Its network takes pictures of 128 x 128
    /// pixels: set the camera's size, too, or put another network.
    pub fn paper() -> Self {
        Self {
            network: NetworkSettings::so2_paper_128px(),
            ppo: PpoSettings::paper(),
            grouping: GroupingSettings::PAPER,
            first_frames: 4,
            rollout_steps: 1000,
            buffer_episodes: None,
            handover: ReassignedRolloutHandling::Reuse,
            new_policy: NewPolicyInit::Random,
            ..Self::default()
        }
    }

    /// Creates the PPO algorithm that trains `policy` on the chosen device.
    fn ppo(&self, policy: &ActorCriticPolicy) -> Result<Ppo, RlError> {
        match &self.device {
            LearningDevice::Cpu => Ppo::on_ranks(self.ppo.clone(), policy, self.ranks.clone()),
            #[cfg(feature = "wgpu")]
            LearningDevice::Gpu(device) => Ppo::on_device(self.ppo.clone(), policy, device),
        }
    }
}

impl PolicyCollectionSettings for CoversSettings {
    type Trainer = PpoTrainer;

    fn common(&self) -> CommonSettings {
        CommonSettings {
            grouping: self.grouping,
            first_frames: self.first_frames,
            rollout_steps: self.rollout_steps,
            buffer_episodes: self.buffer_episodes,
            handover: self.handover,
            new_policy: self.new_policy,
            seed: self.seed,
        }
    }

    fn new_policy(&self, spec: &EnvSpec, seed: u64) -> Result<ActorCriticPolicy, RlError> {
        ActorCriticPolicy::new(&self.network, spec, seed)
    }

    fn policy_with_params(
        &self,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<ActorCriticPolicy, RlError> {
        ActorCriticPolicy::with_params(&self.network, spec, params)
    }

    fn params(policy: &ActorCriticPolicy) -> &[f32] {
        policy.params()
    }

    fn new_rollout(&self, spec: &EnvSpec, steps: usize) -> Result<RolloutBuffer, RlError> {
        RolloutBuffer::new(spec, steps)?.with_noise_correlation(self.noise_correlation)
    }

    fn new_training(&self, _: &EnvSpec, policy: &ActorCriticPolicy) -> Result<PpoTrainer, RlError> {
        Ok(PpoTrainer { ppo: self.ppo(policy)? })
    }
}

/// Trainer of one policy by PPO, on one rollout at a time.
pub struct PpoTrainer {
    ppo: Ppo,
}

impl PolicyTrainer for PpoTrainer {
    type Policy = ActorCriticPolicy;
    type Rollout = RolloutBuffer;

    fn adapt_rollout(
        policy: &mut ActorCriticPolicy,
        rollout: &mut RolloutBuffer,
    ) -> Result<(), RlError> {
        rollout.reevaluate(policy)
    }

    fn learn(
        &mut self,
        policy: &mut ActorCriticPolicy,
        rollout: &mut RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError> {
        Ok(self.ppo.update(policy, rollout, rng)?.metrics())
    }

    fn algorithm_state(&self) -> AlgorithmState<'_> {
        self.ppo.save()
    }

    fn restore_algorithm(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        self.ppo.restore(state)
    }
}

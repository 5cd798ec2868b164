//! Off-policy learners: collections of policies that are trained by soft actor-critic from replays.
//!
//! With one policy for all tasks this is CLEAR, with a context also 3RL; with COVERS's grouping
//! every group of tasks has a policy and a replay buffer of its own.

mod frame_codec;
mod replay_checkpoint;
mod staged_rollout;

use rand_chacha::ChaCha8Rng;
use rl::{
    Algorithm, AlgorithmState, EntropyTemperatureSettings, EnvSpec, Metrics, NetworkSettings,
    PpoSettings, ProcessRanks, RecurrentContextSettings, ReplayBuffer, ReplaySettings, RlError,
    Sac, SacPolicy, SacSettings,
};
use serde::{Deserialize, Serialize};
use symmetry::Group;

use crate::error::LearnerError;
use crate::groupings::GroupingSettings;

use super::collection::{
    CommonSettings, NewPolicyInit, PolicyCollection, PolicyCollectionSettings, PolicyTrainer,
    ReassignedRolloutHandling,
};
use super::tensor_file::{CheckpointTensor, TensorFile};
use staged_rollout::StagedRollout;

/// Learner with a growing collection of policies, or a single one, trained by soft actor-critic.
pub type OffPolicyLearner = PolicyCollection<OffPolicySettings>;

/// Settings of [`OffPolicyLearner`]. [`OffPolicySettings::clear_baseline`] is the default.
///
/// In a file, a field that is missing has its default, and one that does not exist is an error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffPolicySettings {
    /// Sizes and initial values of each policy's network.
    pub network: NetworkSettings,
    /// Recurrent context (GRU) of the last steps of an episode, for the actor and the critics; none
    /// if null.
    pub context: Option<RecurrentContextSettings>,
    /// Settings of the soft actor-critic that trains each policy.
    pub sac: SacSettings,
    /// Largest number of steps that each policy's replay buffer holds.
    pub capacity: usize,
    /// Number of decisions with uniformly random actions, until a policy's replay buffer holds as
    /// many.
    pub warm_up: u64,
    /// Correlation of the noise of consecutive actions, in [0, 1). See [`rl::ActionNoise`].
    pub noise_correlation: f32,
    /// Number of last channels of a picture that do not change during an episode. The replay stores
    /// them once for each episode.
    pub still_channels: usize,
    /// Number of last steps of a replay buffer that count as newest; has no effect if
    /// `sac.newest_share` is 0. That share ([`SacSettings::newest_share`]) of every minibatch is
    /// drawn from them. Task switches need not be known.
    pub newest_steps: u64,
    /// Rule that chooses the policy that a rollout belongs to. Its replay takes rollouts of any
    /// policy, unless they show two groups.
    pub grouping: GroupingSettings,
    /// Number of frames at the start of each episode by which a rollout is assigned to a policy.
    pub first_frames: usize,
    /// Number of decisions of one rollout, all environments together. Gradient steps are taken
    /// between rollouts.
    pub rollout_steps: usize,
    /// Number of episodes whose first frames are kept for each policy, a uniform sample; `None`
    /// keeps all of them.
    pub buffer_episodes: Option<usize>,
    /// Initial parameters of a new policy; its replay buffer is empty.
    pub new_policy: NewPolicyInit,
    /// Seed of all random numbers of the learner.
    pub seed: u64,
    /// Processes that share the updates; settings files do not store them.
    #[serde(skip)]
    pub ranks: ProcessRanks,
}

impl OffPolicySettings {
    /// Returns the settings of the baseline CLEAR, as in the paper of COVERS (Liu et al., CoRL
    /// 2023, appendix). They have one ordinary policy and one replay of 200,000 steps, the newest
    /// of which are drawn more often. The paper does not say which those are, nor how often.
    pub fn clear_baseline() -> Self {
        Self {
            network: NetworkSettings { group: Group::C1, ..NetworkSettings::default() },
            context: None,
            sac: SacSettings {
                // with few and large gradient steps, SAC's 0.005 would lag 8000 decisions behind
                tau: 0.05,
                ..SacSettings::paper()
            },
            capacity: 200_000,
            warm_up: 1000,
            noise_correlation: 0.0,
            // three channels for the first picture of the episode
            still_channels: 3,
            newest_steps: 10_000,
            grouping: GroupingSettings::Single,
            first_frames: 1,
            rollout_steps: 500,
            buffer_episodes: Some(100),
            new_policy: NewPolicyInit::default(),
            seed: 0,
            ranks: ProcessRanks::default(),
        }
    }

    /// Returns the settings of CLEAR with behavioural cloning of the actions in the replay buffer.
    pub fn clear_baseline_with_cloning() -> Self {
        let mut settings = Self::clear_baseline();
        settings.sac.cloning_weight = 0.1;
        settings
    }

    /// Returns the settings of the baseline 3RL, as in the paper of COVERS: CLEAR with a recurrent
    /// context of the last five steps. Windows (sequences of consecutive steps of a minibatch) are
    /// longer, since their steps share the observations that contexts read.
    pub fn three_rl_baseline() -> Self {
        let clear = Self::clear_baseline();
        Self {
            context: Some(RecurrentContextSettings::default()),
            sac: SacSettings { window: 16, ..clear.sac },
            ..clear
        }
    }

    /// Returns the settings of the method `equi-sac`: equivariant policies under COVERS's grouping,
    /// each with a replay buffer whose steps are transformed by random group elements.
    pub fn equi_sac() -> Self {
        let clear = Self::clear_baseline();
        Self {
            network: NetworkSettings::default(),
            sac: SacSettings {
                batch: 128,
                learning_rate: 1e-3,
                tau: 0.02,
                burn_in: 1000,
                newest_share: 0.0,
                augmentation: Group::D2,
                ..clear.sac
            }
            .with_update_ratio_of_ppo(&PpoSettings::tuned()),
            grouping: GroupingSettings::default(),
            ..clear
        }
    }

    /// Returns the settings of the method `covers-sac`: equivariant policies that learn from few
    /// decisions by two gradient steps for each, with a learned temperature, a slow image encoder
    /// and a moving average as the policy.
    pub fn covers_sac() -> Self {
        let equi = Self::equi_sac();
        Self {
            sac: SacSettings {
                batch: 32,
                updates_per_step: 2.0,
                burn_in: 500,
                // the critics drag the encoder along, and features that move fast mislead the actor
                encoder_learning_rate: Some(2e-4),
                // what is trained still moves when the group is learnt, and its average moves less
                average_rate: Some(0.02),
                temperature: EntropyTemperatureSettings::Learned { initial: 0.02, target: 0.3 },
                // gradients of equivariant networks are the same for every image of a step
                augmentation: Group::C1,
                ..equi.sac
            },
            warm_up: 500,
            capacity: 50_000,
            // close-ups change in every step
            still_channels: 0,
            ..equi
        }
    }

    /// Returns the settings of one policy's replay buffer in environments of `spec`.
    fn replay(&self, spec: &EnvSpec) -> ReplaySettings {
        ReplaySettings {
            capacity: self.capacity,
            steps: self.rollout_steps / spec.num_envs.max(1),
            // a staged rollout does the warm-up, before it is assigned to a policy
            warm_up: 0,
            still_channels: self.still_channels,
        }
    }
}

impl Default for OffPolicySettings {
    fn default() -> Self {
        Self::clear_baseline()
    }
}

impl PolicyCollectionSettings for OffPolicySettings {
    type Trainer = SacTrainer;

    fn common(&self) -> CommonSettings {
        CommonSettings {
            grouping: self.grouping,
            first_frames: self.first_frames,
            rollout_steps: self.rollout_steps,
            buffer_episodes: self.buffer_episodes,
            handover: ReassignedRolloutHandling::Reuse,
            new_policy: self.new_policy,
            seed: self.seed,
        }
    }

    fn new_policy(&self, spec: &EnvSpec, seed: u64) -> Result<SacPolicy, RlError> {
        SacPolicy::new(&self.network, self.context, spec, seed)
    }

    fn policy_with_params(&self, spec: &EnvSpec, params: Vec<f32>) -> Result<SacPolicy, RlError> {
        SacPolicy::with_params(&self.network, self.context, spec, params)
    }

    fn params(policy: &SacPolicy) -> &[f32] {
        policy.params()
    }

    fn new_rollout(&self, spec: &EnvSpec, steps: usize) -> Result<StagedRollout, RlError> {
        spec.check_rollout_memory(steps)?;
        StagedRollout::new(spec, steps, self.noise_correlation)
    }

    fn new_training(&self, spec: &EnvSpec, policy: &SacPolicy) -> Result<SacTrainer, RlError> {
        Ok(SacTrainer {
            sac: Sac::on_ranks(self.sac.clone(), policy, self.ranks.clone())?,
            replay: ReplayBuffer::new(self.replay(spec), spec)?,
            warm_up: self.warm_up,
            newest_steps: self.newest_steps,
        })
    }
}

/// Trainer of one policy by soft actor-critic from a replay buffer of the latest steps of its
/// rollouts.
pub struct SacTrainer {
    sac: Sac,
    replay: ReplayBuffer,
    /// Number of decisions with uniformly random actions ([`OffPolicySettings::warm_up`]).
    warm_up: u64,
    /// Number of last steps that count as newest ([`OffPolicySettings::newest_steps`]).
    newest_steps: u64,
}

impl PolicyTrainer for SacTrainer {
    type Policy = SacPolicy;
    type Rollout = StagedRollout;

    fn prepare_rollout(&self, rollout: &mut StagedRollout) {
        let recorded = self.replay.total_recorded_steps();
        rollout.schedule_uniform_actions(self.warm_up.saturating_sub(recorded));
    }

    /// Does nothing: a replay takes steps of any policy unchanged.
    fn adapt_rollout(_: &mut SacPolicy, _: &mut StagedRollout) -> Result<(), RlError> {
        Ok(())
    }

    fn learn(
        &mut self,
        policy: &mut SacPolicy,
        rollout: &mut StagedRollout,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError> {
        rollout.commit_to(&mut self.replay)?;
        self.replay.mark_newest_steps(self.newest_steps);
        Ok(self.sac.update(policy, &self.replay, rng)?.metrics())
    }

    fn algorithm_state(&self) -> AlgorithmState<'_> {
        self.sac.save()
    }

    fn restore_algorithm(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        self.sac.restore(state)
    }

    fn extra_tensors(&self, prefix: &str) -> Vec<CheckpointTensor> {
        replay_checkpoint::replay_buffer_tensors(&self.replay, prefix)
    }

    fn restore_extra_tensors(
        &mut self,
        file: &TensorFile<'_>,
        prefix: &str,
    ) -> Result<(), LearnerError> {
        self.replay = replay_checkpoint::read_replay_buffer(file, prefix, &self.replay)?;
        Ok(())
    }
}

//! Learners of continual reinforcement learning from unlabelled streams of tasks: COVERS (Liu et
//! al., CoRL 2023), the same with replays, CLEAR and 3RL.
//!
//! - [`Learner`]: trains on the rollouts of any [`rl::VectorEnv`]. [`CoversLearner`] is Algorithm 1
//!   of the paper and [`OffPolicyLearner`] its counterpart with replays.
//! - [`Grouping`]: assigns each rollout to a policy.
//! - [`LearnerSettings`]: settings of a learner, which build it or load it from a checkpoint.
//! - [`disk`]: file operations of checkpoints and runs.
//! - [`overrides`]: settings by path, such as `covers.ppo.gamma=0.97`.

pub mod disk;
mod error;
mod groupings;
mod learners;
pub mod overrides;

pub use error::LearnerError;
pub use evidence::{PreviousParameters, RequiredTrial};
pub use groupings::{
    AssignmentData, AssignmentPurpose, EpisodeRequirements, EvidenceGrouping, Grouping,
    GroupingDecision, GroupingSettings, GroupingUpdateInput, GroupingUpdateResult,
    RecognisedPolicy, RemovedGroupingSettings, RolloutEpisodes, SinglePolicyGrouping, TaskLabel,
    ThresholdGrouping,
};
pub use learners::{
    CheckpointExtent, CommonSettings, CoversLearner, CoversSettings, DeviceChoice, IterationReport,
    IterationSeconds, Learner, LearnerSettings, LearningDevice, MetricValue, Metrics,
    NewPolicyInit, OffPolicyLearner, OffPolicySettings, PolicyCollection, PolicyCollectionSettings,
    PolicyEvaluationResult, PolicyTrainer, ReassignedRolloutHandling, Rollout, SingleEnvStep,
    per_policy_metric_names, read_checkpoint_note,
};

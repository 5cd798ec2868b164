//! Learners of continual reinforcement learning from unlabelled streams of tasks: COVERS (Liu et
//! al., CoRL 2023), the same with replays, CLEAR and 3RL.
//!
//! - [`Learner`]: trains on the rollouts of any [`rl::VectorEnv`]. [`Covers`] is Algorithm 1 of the
//!   paper and [`OffPolicy`] its counterpart with replays.
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
pub use evidence::Trial;
pub use groupings::{
    AssignedEpisodes, AssignmentData, AssignmentRequest, EpisodeRequirements, Episodes,
    EvidenceGrouping, Grouping, GroupingDecision, GroupingSettings, GroupingUpdate,
    RecognisedPolicy, RemovedSettings, SinglePolicyGrouping, TaskLabel, ThresholdGrouping,
};
pub use learners::{
    CheckpointExtent, CommonSettings, Covers, CoversSettings, DeviceChoice, IterationReport,
    IterationSeconds, Learner, LearnerSettings, LearningDevice, Metric, Metrics, NewPolicyInit,
    OffPolicy, OffPolicySettings, PolicyCollection, PolicyCollectionSettings, PolicyEvaluation,
    Rollout, RolloutHandover, StepView, Training, per_policy_column_names, read_checkpoint_note,
};

//! Learners, which runs train, behind the trait [`Learner`].
//!
//! To add one: implement [`Learner`], and give it a value of [`LearnerSettings`].

mod collection;
mod covers;
mod device;
mod learner;
mod off_policy;
mod settings;
mod tensor_file;

pub use collection::read_checkpoint_note;
pub use collection::{
    CommonSettings, NewPolicyInit, PolicyCollection, PolicyCollectionSettings, PolicyTrainer,
    ReassignedRolloutHandling, Rollout, SingleEnvStep,
};
pub use covers::{CoversLearner, CoversSettings};
pub use device::{DeviceChoice, LearningDevice};
pub use learner::per_policy_metric_names;
pub use learner::{
    CheckpointExtent, IterationReport, IterationSeconds, Learner, MetricValue, Metrics,
    PolicyEvaluationResult,
};
pub use off_policy::{OffPolicyLearner, OffPolicySettings};
pub use settings::LearnerSettings;

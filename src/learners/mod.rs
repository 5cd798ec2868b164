//! Learners: what a run trains, one folder or file each, behind the trait [`Learner`].
//!
//! To add one: implement [`Learner`], and give it a value of [`LearnerSettings`].

mod collection;
mod covers;
mod device;
mod learner;
mod metrics;
mod off_policy;
mod settings;
mod tensor_file;

pub use collection::{Collection, CollectionSettings, Handover, NewPolicy};
pub(crate) use collection::{per_policy_columns, read_note};
pub use covers::{Covers, CoversSettings};
pub use device::{DeviceChoice, LearningDevice};
pub use learner::{Extent, Learner, Performance, Seconds, Turn};
pub use metrics::{Metric, Metrics};
pub use off_policy::{OffPolicy, OffPolicySettings};
pub use settings::LearnerSettings;

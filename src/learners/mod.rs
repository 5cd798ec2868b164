//! Learners: what a run trains, one folder or file each, behind the trait [`Learner`].
//!
//! To add one: implement [`Learner`], and give it a value of [`LearnerSettings`].

mod covers;
mod learner;
mod metrics;
mod settings;
mod tensor_file;

pub use covers::{Covers, CoversSettings, Embedding, Handover, NewPolicy};
pub use learner::{Extent, Learner, Seconds, Turn};
pub use metrics::{Metric, Metrics};
pub use settings::LearnerSettings;

//! Groupings: which policy a rollout belongs to, behind the trait [`Grouping`].
//!
//! To add one: implement [`Grouping`], and give it a value of [`GroupingSettings`].

mod distance;
mod evidence;
mod grouping;
mod oracle;
mod settings;

pub use distance::Distance;
pub use evidence::Evident;
pub use grouping::{
    Candidates, Episodes, Grouping, GroupingDecision, Learned, Lesson, Needs, Query, Recognised,
};
pub use oracle::{Labels, Single};
pub use settings::{GroupingSettings, RemovedSettings};

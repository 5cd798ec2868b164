//! Groupings: which policy a rollout belongs to, one file each, behind the trait [`Grouping`].
//!
//! To add one: implement [`Grouping`], and give it a value of [`GroupingSettings`].

mod distance;
mod evidence;
mod grouping;
mod oracle;
mod settings;
mod single;

pub use distance::Distance;
pub use evidence::Evident;
pub(crate) use grouping::Answer;
pub use grouping::{Candidates, Episodes, Grouping, Recognised};
pub use oracle::Labels;
pub use settings::GroupingSettings;
pub use single::Single;

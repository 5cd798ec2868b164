//! A collection of policies, one for each group of symmetric tasks: what COVERS and its variants
//! share, whatever trains the policies.

mod algorithm;
mod checkpoint;
mod courses;
mod first_frames;
mod logged;
mod member;
mod note;
mod policies;
mod settings;
mod training;
mod trials;

pub use first_frames::Rollout;
pub(crate) use logged::per_policy_columns;
pub use note::read_note;
pub use policies::Collection;
pub(in crate::learners) use settings::shared_settings;
pub use settings::{CollectionSettings, Handover, NewPolicy};
pub use training::Training;

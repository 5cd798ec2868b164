//! COVERS: a collection of policies, one for each group of symmetric tasks.
//!
//! With other networks and groupings the same learner is each of the paper's PPO baselines.

mod algorithm;
mod checkpoint;
mod collection;
mod first_frames;
mod member;
mod settings;

pub use collection::Covers;
pub use settings::{CoversSettings, Embedding, Handover, NewPolicy};

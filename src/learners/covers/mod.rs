//! COVERS: a collection of policies that are trained by PPO.
//!
//! With other networks and groupings the same learner is each of the paper's PPO baselines.

mod settings;
mod training;

pub use settings::CoversSettings;

use super::collection::Collection;

/// The learner of the paper: a growing collection of policies, trained by PPO.
pub type Covers = Collection<CoversSettings>;

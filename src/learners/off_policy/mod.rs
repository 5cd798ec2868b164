//! Off-policy learners: collections of policies that are trained by soft actor-critic from replays.
//!
//! With one policy for everything this is CLEAR, with a context 3RL; with COVERS's grouping every
//! group of tasks has a policy and a replay of its own.

mod memory;
mod pictures;
mod recording;
mod settings;
mod training;

pub use settings::OffPolicySettings;

use super::collection::Collection;

/// A growing collection of policies, or a single one, trained by soft actor-critic.
pub type OffPolicy = Collection<OffPolicySettings>;

//! Recognition of groups of tasks from whole episodes, without features that a policy has learnt.
//!
//! A learner with several policies must find out which of them a task belongs to. The features of a
//! policy's own network encode where objects are, because the policy needs that, and encode poorly
//! which objects they are. This crate compares whole episodes instead:
//!
//! - [`RandomFilters`] describe the content of an image and not positions, and are invariant under
//!   D2 to the bit.
//! - An [`EpisodeSummary`] holds the first image and vector of an episode, the linear response of
//!   the vector to actions (motion), that of the reward (reward gradient), and the return.
//! - A [`Recogniser`] remembers the summaries of each policy and decides which policy's task group
//!   new episodes show, by one permutation test of all sources with a stated rate of false alarms.
//!   Distances are exact, certified 1-Wasserstein distances of the crate `cluster`.
//!
//! Motion, reward gradient and return depend on the policy that acted, so they count only if a
//! policy is compared with its own episodes. Higher returns are no evidence: a policy whose returns
//! are as high elsewhere as in its own group serves there as well.

mod choice;
mod error;
mod filters;
mod memory;
mod merging;
mod motion;
mod policy_test;
mod probability;
mod recogniser;
mod review;
mod settings;
mod state;
mod summary;
mod tester;

pub use error::EvidenceError;
pub use filters::RandomFilters;
pub use policy_test::PolicyTestResult;
pub use probability::TaskGroupProbabilities;
pub use recogniser::{
    PreviousParameters, Recogniser, RequiredTrial, RolloutDecision, RolloutDecisionContext,
};
pub use settings::RecogniserSettings;
pub use summary::{EpisodeSummariser, EpisodeSummary, ImageFeatureCache, Trajectory};

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

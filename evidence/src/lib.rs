//! Recognition of groups of tasks by whole episodes, without the features that a policy has learnt.
//!
//! A learner with several policies must find out which of them a task belongs to. The features of a
//! policy's own network encode where objects are, because the policy needs that, and encode poorly
//! which objects they are. This crate compares whole episodes instead:
//!
//! - [`Filters`] are a fixed bank of random filters, which describes the content of a picture and
//!   not positions, and is invariant under D2 to the bit.
//! - An [`Account`] summarises one episode: the first picture and vector, the linear response of
//!   the vector to actions (motion), that of the reward (slope), and the return (earnings).
//! - A [`Recogniser`] remembers the summaries of each policy and decides whose task new episodes
//!   show, by one permutation test of all sources with a stated rate of false alarms. Distances are
//!   exact, certified 1-Wasserstein distances of the crate `cluster`.
//!
//! Motion, slope and earnings depend on the policy that acted, so they count only if a policy is
//! compared with its own episodes. Higher earnings are no evidence: a policy that earns as much
//! elsewhere as in its own group serves there as well.

mod account;
mod choice;
mod error;
mod examiner;
mod filters;
mod memory;
mod merging;
mod motion;
mod opinion;
mod probability;
mod recogniser;
mod settings;
mod state;

pub use account::{Account, Accountant, Album, Course};
pub use error::EvidenceError;
pub use filters::Filters;
pub use opinion::Opinion;
pub use probability::Probabilities;
pub use recogniser::{Finding, Recogniser, Situation, Trial};
pub use settings::RecogniserSettings;

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;

//! Recognises groups of tasks by evidence that no policy owns.
//!
//! A learner with several policies must find out whose task it faces. The features of a policy's
//! own network tell what the policy needs, which is where things lie, and are poor at telling what
//! they are. This crate looks at whole episodes with other eyes:
//!
//! - [`Filters`] describe a picture by what is in it and not by where: a fixed bank of random
//!   filters, invariant under D2 to the bit.
//! - An [`Account`] sums up one episode: the picture and the vector at its beginning, how vectors
//!   answered to actions, and what was earned.
//! - A [`Recogniser`] remembers accounts of each policy and decides whose task new episodes show:
//!   one permutation test of all sources at once, whose rate of false alarms is stated; distances
//!   are exact, certified 1-Wasserstein distances of the crate `cluster`.
//!
//! What a course shows, motion and earnings, depends on who acted. It counts only where a policy is
//! compared with what it did itself; and fewer earnings count, more do not: a policy that earns
//! elsewhere what it earns at home serves there as well.

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

pub use account::{Account, Accountant, Course};
pub use error::EvidenceError;
pub use filters::{Album, Filters};
pub use merging::Merge;
pub use opinion::{Look, Opinion};
pub use probability::Probabilities;
pub use recogniser::{Finding, Recogniser, Situation};
pub use settings::RecogniserSettings;

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;

//! Continual vision-based reinforcement learning with group symmetries: COVERS (Liu et al., CoRL 2023) in Rust.
//!
//! A learner watches a table through a top-down camera while tasks arrive in a stream that nobody labels. It grows one
//! D2-equivariant policy per group of symmetric tasks, notices a change of group by the 1-Wasserstein distance of
//! invariant features, recalls old policies, and solves symmetric variants that it never trained on.
//!
//! - [`Covers`]: the learner, Algorithm 1 of the paper. It learns from anything that implements [`rl::VectorEnv`].
//! - [`Stream`]: the four task groups of the paper on MuJoCo as such an environment.
//! - [`Run`]: a whole run with its files, as `examples/continual_stream.rs` shows; it can stop anywhere and go on later.

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub mod check;
pub mod cli;
pub mod commands;
mod covers;
mod error;
pub mod evaluation;
mod experiment;
mod first_frames;
mod ledger;
mod logs;
mod progress;
pub mod report;
mod run;
mod run_folder;
pub mod schedule;
pub mod sheet;
mod stream;

pub use covers::{Covers, CoversSettings, Embedding, Extent, Handover, NewPolicy, Report, Seconds};
pub use error::CoversError;
pub use experiment::{EvaluationPlan, Experiment};
pub use ledger::Ledger;
pub use progress::Progress;
pub use run::{Run, Summary};
pub use run_folder::RunFolder;
pub use stream::Stream;

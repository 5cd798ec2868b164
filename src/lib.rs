//! Continual vision-based reinforcement learning with group symmetries: COVERS (Liu et al., CoRL
//! 2023) in Rust.
//!
//! A learner watches a table through a top-down camera while tasks arrive in a stream that nobody
//! labels. It grows one D2-equivariant policy per group of symmetric tasks, notices a change of
//! group by the 1-Wasserstein distance of invariant features, recalls old policies, and solves
//! symmetric variants that it never trained on.
//!
//! - [`Learner`]: what a run trains. [`Covers`] is Algorithm 1 of the paper; it learns from
//!   anything that implements [`rl::VectorEnv`].
//! - [`Grouping`]: the decision which policy a rollout belongs to.
//! - [`Stream`]: task groups on MuJoCo as such an environment.
//! - [`Run`]: a whole run with its files, as `examples/continual_stream.rs` shows; it can stop
//!   anywhere and go on later.

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub mod check;
pub mod cli;
pub mod commands;
mod error;
pub mod evaluation;
mod experiment;
mod groupings;
mod learners;
mod ledger;
mod logs;
pub mod presets;
mod progress;
mod run;
mod run_folder;
pub mod schedule;
pub mod sheet;
mod stream;
pub mod tables;

pub use error::CoversError;
pub use experiment::{EvaluationPlan, Experiment};
pub use groupings::{Candidates, Distance, Grouping, GroupingSettings, Labels, Single};
pub use learners::{
    Covers, CoversSettings, Embedding, Extent, Handover, Learner, LearnerSettings, Metric, Metrics,
    NewPolicy, Seconds, Turn,
};
pub use ledger::Ledger;
pub use progress::Progress;
pub use run::{Run, Summary};
pub use run_folder::RunFolder;
pub use stream::Stream;

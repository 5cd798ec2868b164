//! Rules for tasks, as functions that a task's tests call.
//!
//! [`check`] tests a group against all rules in one line. [`experts()`] and [`symmetry()`] measure
//! one variant on a chosen number of placements.
//!
//! ```no_run
//! #[test]
//! fn my_task_conforms() -> Result<(), envs::conformance::Flaw> {
//!     envs::conformance::check(envs::TaskGroup::DRAWER_CLOSE)
//! }
//! ```

mod case;
mod experts;
mod rules;
mod scene_rules;
mod symmetry;

pub use experts::{ExpertRow, VariantName, experts};
pub use rules::{Flaw, check};
pub use symmetry::{SymmetryRow, symmetry};

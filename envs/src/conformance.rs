//! What every task must do, as functions for the tests of whoever writes one.
//!
//! [`check`] holds a group to all rules: one line in a test. [`experts()`] and [`symmetry()`]
//! return figures of one variant on as many placements as wanted.
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

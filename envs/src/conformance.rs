//! Conformance rules for tasks, as functions that a task's tests call.
//!
//! [`check_task_conformance`] tests a group against all rules in one line. [`measure_expert`] and
//! [`measure_symmetry`] measure one variant on a chosen number of placements.
//!
//! ```no_run
//! #[test]
//! fn my_task_conforms() -> Result<(), envs::conformance::ConformanceError> {
//!     envs::conformance::check_task_conformance(envs::TaskGroup::DRAWER_CLOSE)
//! }
//! ```

mod case;
mod experts;
mod rules;
mod scene_rules;
mod symmetry;

pub use experts::{ExpertResult, VariantName, measure_expert};
pub use rules::{ConformanceError, check_task_conformance, check_task_conformance_with};
pub use symmetry::{SymmetryDeviation, measure_symmetry};

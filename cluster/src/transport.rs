//! Optimal transport between weighted points on a given cost matrix.
//!
//! From the bottom up: [`problem`] says what is solved and what comes out, and
//! [`certificate`] checks one against the other. [`mass`], [`basis`], [`lanes`], [`pricing`] and
//! [`start`] are the parts of the simplex method that [`solver`] puts together.

mod basis;
mod certificate;
mod lanes;
mod mass;
mod pricing;
mod problem;
mod solver;
mod start;

pub use certificate::{COST_TOLERANCE, RELATIVE_TOLERANCE, certify};
pub use problem::{Certificate, Entry, MAX_COST, TransportPlan, Weights};
pub use solver::{Solver, transport};

pub(crate) use mass::Balance;
pub(crate) use problem::check_weights_of;

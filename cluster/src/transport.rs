//! Optimal transport between weighted points on a given cost matrix.
//!
//! From the bottom up: [`problem`] defines the input and the output, and [`certificate`] checks one
//! against the other. [`mass`], [`basis`], [`lanes`], [`pricing`] and [`start`] are the parts of
//! the network simplex method in [`solver`].

mod basis;
mod certificate;
mod lanes;
mod mass;
mod pricing;
mod problem;
mod solver;
mod start;

pub use certificate::{
    CERTIFICATE_RELATIVE_TOLERANCE, MAX_RELATIVE_DUALITY_GAP, certify_optimality,
};
pub use problem::{
    MAX_ABS_COST, OptimalityCertificate, PointWeights, TransportPlan, TransportPlanEntry,
};
pub use solver::{TransportSolver, solve_transport};

pub(crate) use problem::check_weights_of;

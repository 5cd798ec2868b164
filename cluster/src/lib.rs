//! Exact 1-Wasserstein distances between point clouds, and the assignment of new points to known
//! groups by these distances.
//!
//! The crate works on points alone, without tasks, networks or policies. It has three parts.
//!
//! - Distances. [`wasserstein1`] is the exact 1-Wasserstein distance with Euclidean ground cost and
//!   equal weights, [`wasserstein1_gradient`] its gradient in the points. [`WassersteinSolver`]
//!   takes any weights and reuses its memory. [`solve_transport`] and [`TransportSolver`] solve the
//!   same problem on a given cost matrix. Each answer carries potentials that prove it optimal, and
//!   [`certify_optimality`] checks the proof before the answer is returned.
//! - Comparison. [`joint_permutation_test`] is a permutation test of several sources of evidence,
//!   by whole episodes, and [`changepoint_test`] one for a changepoint. [`assign_by_threshold`] is
//!   the paper's rule of assignment. [`nearer_policy_margin`] compares two groups from as little
//!   as one frame.
//! - Memory. [`Reservoir`] keeps a bounded uniform sample of the episodes of a group.

mod assignment;
mod change;
mod check;
mod comparison;
mod error;
mod euclidean;
mod frames;
mod joint;
mod permutation;
mod reservoir;
mod transport;
mod wasserstein;

pub use assignment::{
    AssignedPolicy, PolicyAssignment, PolicyEvidence, PolicyVerdict, assign_by_threshold,
};
pub use change::{ChangepointTestResult, changepoint_candidates, changepoint_test};
pub use comparison::{NearerPolicyInputs, nearer_policy_margin};
pub use error::ClusterError;
pub use euclidean::EuclideanDistances;
pub use frames::{FrameFeatures, RolloutAndBufferFeatures};
pub use joint::{
    AlternativeHypothesis, EvidenceSourceSamples, EvidenceSourceTestResult,
    JointPermutationTestResult, joint_permutation_test,
};
pub use permutation::{NullDistribution, PermutationTestResult};
pub use reservoir::Reservoir;
pub use transport::{
    CERTIFICATE_RELATIVE_TOLERANCE, MAX_ABS_COST, MAX_RELATIVE_DUALITY_GAP, OptimalityCertificate,
    PointWeights, TransportPlan, TransportPlanEntry, TransportSolver, certify_optimality,
    solve_transport,
};
pub use wasserstein::{
    WassersteinGradient, WassersteinSolver, WeightedCloud, wasserstein1, wasserstein1_gradient,
};

#[cfg(test)]
mod fixtures {
    use rand::RngExt;
    use rand_chacha::ChaCha8Rng;

    /// Draws uniform numbers within 1 of the centre.
    pub fn draw(count: usize, centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
        let draw = |_| centre + rng.random_range(-1.0..1.0);
        (0..count).map(draw).collect()
    }
}

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

//! Exact 1-Wasserstein distances between point clouds, and the assignment of new points to known
//! groups by these distances.
//!
//! The crate works on points alone, without tasks, networks or policies. It has three parts.
//!
//! - Distances. [`wasserstein1`] is the exact 1-Wasserstein distance with Euclidean ground cost and
//!   equal weights, and [`wasserstein1_gradient`] its gradient in the points. [`Wasserstein`] takes
//!   any weights and reuses its memory. [`transport()`] and [`Solver`] solve the same problem on a
//!   given cost matrix. Each answer carries potentials that prove it optimal, and [`certify`]
//!   checks the proof before the answer is returned.
//! - Comparison. [`joint_test`] is a permutation test of several sources of evidence, by whole
//!   episodes, and [`change_test`] one for a changepoint. [`assign_by_threshold`] is the paper's
//!   rule of assignment. [`lead`] compares two groups from as little as one frame.
//! - Memory. [`Reservoir`] keeps a bounded uniform sample of the episodes of a group.
//!
//! # Definitions
//!
//! For clouds `X` of `n` and `Y` of `m` points, with `M_il = ||X_i - Y_l||_2`,
//!
//! ```text
//! W1(X, Y) = min <gamma, M>_F   subject to   gamma 1 = 1/n,  gamma^T 1 = 1/m,  gamma >= 0.
//! ```
//!
//! This equation and the rule of [`assign_by_threshold`] are those of Liu et al., "Continual
//! Vision-based Reinforcement Learning with Group Symmetries" (CoRL 2023), section 4.3 and Algorithm
//! 1. [`joint_test`] compares `W1` with its distribution over random splits of the pooled episodes,
//!
//! ```text
//! score = (W1 - mean) / sd,    p = (1 + splits at least as far apart) / (1 + splits),
//! ```
//!
//! and therefore depends neither on the scale of a network's features nor on the spread of its
//! group.
//!
//! # Example
//!
//! ```
//! use cluster::{Candidate, Decision, Frames, Side, Source, assign_by_threshold, joint_test};
//! use rand::{RngExt, SeedableRng};
//! use rand_chacha::ChaCha8Rng;
//!
//! let mut rng = ChaCha8Rng::seed_from_u64(1);
//! // 20 episodes of 4 frames in 8 dimensions, around a centre
//! let mut episodes = |centre: f32| {
//!     let features = (0..20 * 4 * 8).map(|_| centre + rng.random_range(-1.0..1.0)).collect();
//!     Frames::new(features, 4, 8)
//! };
//! let (known, rollout) = (episodes(0.0)?, episodes(0.0)?);
//! let near = Candidate { buffer: known, rollout: rollout.clone() };
//! let far = Candidate { buffer: episodes(5.0)?, rollout };
//!
//! // the threshold is in the features' unit
//! let assignment = assign_by_threshold(&[far.clone(), near.clone()], 2.0)?;
//! assert_eq!(assignment.decision, Decision::Existing(1));
//! // a test needs no threshold
//! let mut p_value = |clouds| {
//!     let source = Source { clouds, side: Side::Both };
//!     joint_test(&[source], 100, &mut rng).map(|test| test.p_value)
//! };
//! assert!(p_value(far)? < 0.02 && p_value(near)? > 0.02);
//! # Ok::<(), cluster::ClusterError>(())
//! ```

mod assignment;
mod change;
mod check;
mod contest;
mod error;
mod euclidean;
mod frames;
mod joint;
mod line;
mod permutation;
mod reservoir;
mod tail;
mod transport;
mod wasserstein;

pub use assignment::{Assignment, Decision, Evidence, Judgement, Verdict, assign_by_threshold};
pub use change::{ChangeTest, change_places, change_test};
pub use contest::{Contest, lead};
pub use error::ClusterError;
pub use euclidean::EuclideanCosts;
pub use frames::{Candidate, Frames};
pub use joint::{JointTest, Side, Source, SourceTest, joint_test, joint_test_until};
pub use line::wasserstein1_line;
pub use permutation::{NullDistribution, PermutationTest};
pub use reservoir::Reservoir;
pub use transport::{
    Certificate, Entry, MAX_COST, MAX_RELATIVE_GAP, RELATIVE_TOLERANCE, Solver, TransportPlan,
    Weights, certify, transport,
};
pub use wasserstein::{
    Cloud, Wasserstein, WassersteinGradient, wasserstein1, wasserstein1_gradient,
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
pub struct Readme;

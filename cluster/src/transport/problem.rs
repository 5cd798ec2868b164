//! Transport problem: costs, weights, plans, and the checks of the input.

use crate::check::{check_len, check_positive, check_range};
use crate::error::{ClusterError, Result};

/// Largest accepted magnitude of a cost in a cost matrix, at which sums of costs along any path
/// stay far from overflow.
pub const MAX_ABS_COST: f64 = 1e100;

/// Largest accepted deviation of the sum of given weights from one. Rounding to `f32` moves the sum
/// by at most 6e-8, and a softmax computed in `f32` adds more, the more points it has: 1e-6 is
/// enough for a thousand.
const SUM_TOLERANCE: f64 = 1e-6;

/// Weights of the points on one side of a transport problem, all sources or all sinks: equal, or
/// given for each point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointWeights<'a> {
    /// Equal weights of as many points as the number says.
    Uniform(usize),
    /// One weight for each point: at least 0, of sum one within 1e-6, and divided by their sum.
    Given(&'a [f64]),
}

impl PointWeights<'_> {
    /// Returns the number of points that the weights belong to.
    #[expect(
        clippy::len_without_is_empty,
        reason = "every function that takes weights refuses an empty side"
    )]
    pub fn len(&self) -> usize {
        match self {
            Self::Uniform(points) => *points,
            Self::Given(weights) => weights.len(),
        }
    }

    /// Returns the weight of point `index`, not divided by the sum of the weights.
    pub(crate) fn get(&self, index: usize) -> f64 {
        match self {
            Self::Uniform(points) => 1.0 / *points as f64,
            Self::Given(weights) => weights[index],
        }
    }

    pub(crate) fn sum(&self) -> f64 {
        match self {
            Self::Uniform(_) => 1.0,
            Self::Given(weights) => weights.iter().sum(),
        }
    }
}

pub(super) fn check(cost: &[f64], sources: PointWeights, sinks: PointWeights) -> Result<()> {
    check_weights([("sources", sources), ("sinks", sinks)])?;
    check_shape(cost, sources.len(), sinks.len())?;
    check_nodes(sources.len(), sinks.len())?;
    check_costs(cost)
}

/// Checks that 32-bit node indices can number the sources and sinks together.
fn check_nodes(sources: usize, sinks: usize) -> Result<()> {
    let nodes = sources.checked_add(sinks);
    let few = nodes.is_some_and(|nodes| nodes < u32::MAX as usize);
    let value = sources as f64 + sinks as f64;
    check_range("sources + sinks", value, few, "fewer than 2^32 - 1")
}

/// Checks that `cost` is a matrix `[sources, sinks]`.
fn check_shape(cost: &[f64], sources: usize, sinks: usize) -> Result<()> {
    if sources.checked_mul(sinks) == Some(cost.len()) {
        Ok(())
    } else {
        Err(ClusterError::CostShape { len: cost.len(), sources, sinks })
    }
}

/// Checks that all costs are finite and within [`MAX_ABS_COST`].
fn check_costs(cost: &[f64]) -> Result<()> {
    let accepted = |c: &f64| c.abs() <= MAX_ABS_COST;
    // a loop over the whole matrix without an early exit compiles to vector code
    if cost.iter().fold(true, |all, c| all & accepted(c)) {
        return Ok(());
    }
    let index = cost.iter().position(|c| !accepted(c)).unwrap_or(0);
    let value = cost[index];
    Err(if value.is_finite() {
        ClusterError::CostTooLarge { index, value, limit: MAX_ABS_COST }
    } else {
        ClusterError::NonFinite { what: "cost", index, value }
    })
}

/// Checks that two named sides have weights, all finite and at least 0, of sum one.
fn check_weights(sides: [(&'static str, PointWeights); 2]) -> Result<()> {
    for (side, weights) in sides {
        check_positive(side, weights.len())?;
        let PointWeights::Given(given) = weights else {
            continue;
        };
        if let Some(index) = given.iter().position(|w| !w.is_finite() || *w < 0.0) {
            let value = given[index];
            return Err(ClusterError::Weight { what: side, index, value });
        }
    }
    let [(first, a), (second, b)] = sides;
    let sums = [a.sum(), b.sum()];
    if sums.iter().all(|sum| (sum - 1.0).abs() <= SUM_TOLERANCE) {
        Ok(())
    } else {
        Err(ClusterError::WeightSums { sides: [first, second], sums, tolerance: SUM_TOLERANCE })
    }
}

/// Checks the weights `a` of the cloud `x` of `n` points and `b` of the cloud `y` of `m`: one
/// finite number of at least 0 for each point, of sum one.
pub(crate) fn check_weights_of(a: PointWeights, n: usize, b: PointWeights, m: usize) -> Result<()> {
    check_weights([("x", a), ("y", b)])?;
    check_len("weights of x", a.len(), n)?;
    check_len("weights of y", b.len(), m)
}

/// Entry of a transport plan: the mass that goes from one source to one sink.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransportPlanEntry {
    /// Index of the source, a row of the cost matrix, in `0..n`.
    pub source: usize,
    /// Index of the sink, a column of the cost matrix, in `0..m`.
    pub sink: usize,
    /// Mass `gamma_ij` that goes from the source to the sink, in `(0, 1]`.
    pub mass: f64,
}

/// Certified optimal transport plan and the potentials that prove it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransportPlan {
    /// Optimal value `<gamma, M>` of the transport problem (masses times costs), in the costs'
    /// unit.
    pub cost: f64,
    /// Positive entries of `gamma`, at most `n + m - 1`; each (source, sink) pair occurs at most
    /// once.
    pub entries: Vec<TransportPlanEntry>,
    /// Dual potentials `u` of the sources, `[n]`.
    pub source_potentials: Vec<f64>,
    /// Dual potentials `v` of the sinks, `[m]`; `u_i + v_j <= c_ij` for all pairs.
    pub sink_potentials: Vec<f64>,
    /// Precision to which the potentials prove the transport plan optimal.
    pub certificate: OptimalityCertificate,
    /// Number of pivots of the simplex method.
    pub pivots: usize,
}

/// Precision to which a transport plan and its potentials prove each other optimal.
///
/// The value of a plan exceeds the optimum by at most `gap + violation`, in the costs' unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OptimalityCertificate {
    /// Largest deviation of a row or column sum of the transport plan from its weight, as a
    /// fraction of all mass.
    pub marginal_error: f64,
    /// Largest `u_i + v_j - c_ij` over all pairs, or zero, in the costs' unit.
    pub violation: f64,
    /// Cost of the transport plan less the value of the potentials, in magnitude, or the sum of the
    /// entries' slacks times their masses if that is more, in the costs' unit.
    pub gap: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_points_than_a_basis_can_number_are_refused() {
        assert!(check_nodes(4_000_000_000, 294_967_294).is_ok());
        let error = check_nodes(1, 5_000_000_000).unwrap_err();
        let message = "sources + sinks is 5000000001: expected fewer than 2^32 - 1";
        assert_eq!(error.to_string(), message);
        assert!(check_nodes(usize::MAX, 1).is_err());
    }
}

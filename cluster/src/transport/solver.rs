//! Network simplex method on a cost matrix.

use super::basis::Basis;
use super::certificate::{Scratch, certify_into};
use super::mass::Balance;
use super::pricing::Pricing;
use super::problem::{PointWeights, check};
use super::problem::{TransportPlan, TransportPlanEntry};
use super::start::Start;
use crate::error::{ClusterError, Result};

/// Factor by which the tolerance of reduced costs at an optimum may exceed the one that its own
/// potentials require.
const COARSER: f64 = 16.0;

/// Largest number of simplex pivots per node (source or sink). Clouds of up to 4000 points need
/// fewer than 20, and squared distances on a line need 60.
const PIVOTS_PER_NODE: usize = 1000;

/// Solves the transport problem from n sources to m sinks with the row-major cost matrix `cost`
/// `[n, m]`, whose entries may be negative.
///
/// The answer is exact up to rounding and carries its own proof; see
/// [`certify_optimality`](crate::certify_optimality). Huge costs that forbid a pair do not reduce
/// the precision: if they would, the problem is solved again with such costs lowered. Among costs
/// that the optimum uses, differences below some 1e-14 of the largest are lost in rounding.
/// [`TransportSolver`] reuses its memory from problem to problem.
///
/// # Errors
/// An empty side, weights that are negative, not finite or not of sum one, a misshapen matrix, a
/// cost that is not finite or exceeds [`MAX_ABS_COST`](crate::MAX_ABS_COST), and an answer that the
/// certificate refuses: [`ClusterError::Imprecise`] where rounding leaves more than
/// [`MAX_RELATIVE_DUALITY_GAP`](crate::MAX_RELATIVE_DUALITY_GAP) of the cost open.
///
/// ```
/// use cluster::{PointWeights, solve_transport};
///
/// // a baker with three quarters of the bread, one with a quarter; two cafes
/// let cost = [1.0, 4.0, 2.0, 3.0];
/// let (sources, sinks) = (PointWeights::Given(&[0.75, 0.25]), PointWeights::Uniform(2));
/// let plan = solve_transport(&cost, sources, sinks)?;
/// assert_eq!(plan.cost, 0.5 * 1.0 + 0.25 * 4.0 + 0.25 * 3.0);
/// # Ok::<(), cluster::ClusterError>(())
/// ```
pub fn solve_transport(
    cost: &[f64],
    sources: PointWeights,
    sinks: PointWeights,
) -> Result<TransportPlan> {
    let mut solver = TransportSolver::default();
    solver.solve(cost, sources, sinks)?;
    Ok(solver.plan)
}

/// Solver of transport problems by the network simplex method, with memory that is reused: solving
/// a problem no larger than an earlier one allocates nothing.
///
/// G. B. Dantzig, "Application of the simplex method to a transportation problem" (1951), on a
/// spanning tree of sources and sinks; weights are exact integers, perturbed against degeneracy, so
/// the method cannot cycle. Answers depend on the problem alone.
#[derive(Clone, Debug, Default)]
pub struct TransportSolver {
    balance: Balance,
    basis: Basis,
    start: Start,
    pricing: Pricing,
    plan: TransportPlan,
    scratch: Scratch,
    /// Cost matrix with costs above a ceiling lowered to it, see [`Self::improve_below`].
    lowered: Vec<f64>,
}

impl TransportSolver {
    /// Creates a solver that has allocated nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Solves a transport problem as [`solve_transport`] does; returns the plan, which the next
    /// call overwrites.
    ///
    /// # Errors
    /// Errors of [`solve_transport`].
    pub fn solve(
        &mut self,
        cost: &[f64],
        sources: PointWeights,
        sinks: PointWeights,
    ) -> Result<&TransportPlan> {
        check(cost, sources, sinks)?;
        self.balance.fill(sources, sinks);
        let masses = &self.balance.masses;
        self.start.build(&mut self.basis, cost, masses, sinks.len());
        self.plan.pivots = self.improve(cost)?;
        self.read_plan(cost);
        let mut ceiling = f64::INFINITY;
        loop {
            // huge costs in the basis hide small ones: lower the ceiling until the proof holds
            match certify_into(&mut self.scratch, cost, sources, sinks, &self.plan) {
                Err(error @ ClusterError::Imprecise { .. }) => {
                    ceiling = self.lower_ceiling(cost, ceiling).ok_or(error)?;
                }
                certificate => {
                    self.plan.certificate = certificate?;
                    return Ok(&self.plan);
                }
            }
            self.plan.pivots += self.improve_below(ceiling, cost)?;
            self.read_plan(cost);
        }
    }

    /// Returns a bound on the costs of the arcs of every optimal plan; `None` unless it lies in the
    /// lower half of the range from the least cost to `ceiling`.
    ///
    /// Two plans differ by cycles of at most `k = min(n, m)` arcs of either. Where the present plan
    /// uses no arc above `t`, exchanging a cycle with an arc above `k t - (k - 1) least` for arcs
    /// of the present plan lowers the cost. Nor does a cheaper plan use an arc, one unit at least,
    /// that alone exceeds `least` by more than all units of the present plan do.
    fn lower_ceiling(&self, cost: &[f64], ceiling: f64) -> Option<f64> {
        let plan = &self.plan;
        let (n, m) = (plan.source_potentials.len(), plan.sink_potentials.len());
        let least = cost.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = cost.iter().copied().fold(least, f64::max).min(ceiling);
        let used = plan.entries.iter().map(|e| cost[e.source * m + e.sink]);
        let dearest = used.fold(least, f64::max);
        let by_cycles = (n.min(m) as f64 + 1.0) * (dearest - least);
        let by_units = 2.0 * self.balance.total as f64 * (plan.cost - least).max(0.0);
        let span = by_cycles.min(by_units);
        (span < (largest - least) / 2.0).then_some(least + span)
    }

    /// Continues the simplex method with costs above `ceiling` lowered to it, and returns the
    /// number of pivots.
    ///
    /// If no cheap arc links two parts of the basis, expensive arcs without mass do, and potentials
    /// as large as their costs hide the differences between all others. Potentials that are
    /// feasible for lowered costs are feasible for the costs as given, too.
    fn improve_below(&mut self, ceiling: f64, cost: &[f64]) -> Result<usize> {
        let mut lowered = std::mem::take(&mut self.lowered);
        lowered.clear();
        lowered.extend(cost.iter().map(|c| c.min(ceiling)));
        self.basis.refresh_prices(&lowered);
        let pivots = self.improve(&lowered);
        self.lowered = lowered;
        pivots
    }

    /// Runs the simplex method until no arc has a negative reduced cost, and returns the number of
    /// pivots.
    fn improve(&mut self, cost: &[f64]) -> Result<usize> {
        let mut pivots = 0;
        loop {
            self.pricing.reset(cost, &self.basis, self.basis.price_tolerance());
            self.descend(cost, &mut pivots)?;
            self.basis.refresh_prices(cost);
            // expensive arcs make large potentials: once they have left the basis, the tolerance
            // shrinks, and smaller differences between cheap arcs count
            if COARSER * self.basis.price_tolerance() >= self.pricing.tolerance() {
                return Ok(pivots);
            }
        }
    }

    fn descend(&mut self, cost: &[f64], pivots: &mut usize) -> Result<()> {
        let nodes = self.basis.nodes();
        while let Some(entering) = self.pricing.next(cost, &self.basis) {
            if *pivots == PIVOTS_PER_NODE * nodes {
                return Err(ClusterError::Stalled { pivots: *pivots });
            }
            self.basis.pivot(entering);
            *pivots += 1;
            // every pivot adds rounding to the prices
            if pivots.is_multiple_of(nodes) {
                self.basis.refresh_prices(cost);
                self.pricing.tolerate(self.basis.price_tolerance());
            }
        }
        Ok(())
    }

    fn read_plan(&mut self, cost: &[f64]) {
        let (balance, plan) = (&self.balance, &mut self.plan);
        plan.source_potentials.clear();
        plan.source_potentials.extend_from_slice(self.basis.source_prices());
        plan.sink_potentials.clear();
        plan.sink_potentials.extend(self.basis.sink_prices().iter().map(|price| -price));
        plan.entries.clear();
        plan.entries.reserve(self.basis.nodes());
        let mut cost_in_units = 0.0;
        self.basis.for_each_arc(|source, sink, flow| {
            // arcs that carry infinitesimals alone are part of the basis, not of the plan
            if flow.units > 0 {
                let mass = flow.units as f64 / balance.total as f64;
                plan.entries.push(TransportPlanEntry { source, sink, mass });
                cost_in_units +=
                    flow.units as f64 * cost[source * self.basis.sink_prices().len() + sink];
            }
        });
        plan.cost = cost_in_units / balance.total as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::mass::Mass;

    #[test]
    fn each_basic_flow_is_positive_and_all_are_balanced() {
        // equal and zero weights on tied costs, where nothing but the perturbation keeps the basis
        // from degeneracy
        let (zeros, mut solver) = ([0.0, 0.25, 0.25, 0.0, 0.5, 0.0], TransportSolver::new());
        let cost: Vec<f64> = (0..30 * 30).map(|k| (k * k % 11 % 3) as f64).collect();
        let (equal, given) = (PointWeights::Uniform(30), PointWeights::Given(&zeros));
        for (a, b) in [(equal, equal), (given, equal), (equal, given), (given, given)] {
            let cost = &cost[..a.len() * b.len()];
            assert!(solver.solve(cost, a, b).unwrap().pivots > 0);
            let mut left = solver.balance.masses.clone();
            solver.basis.for_each_arc(|source, sink, flow| {
                assert!(flow > Mass::ZERO, "{source} to {sink}: {flow:?}");
                left[source] -= flow;
                left[a.len() + sink] -= flow;
            });
            assert!(left.iter().all(|mass| *mass == Mass::ZERO), "{left:?}");
        }
    }
}

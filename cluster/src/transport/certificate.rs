//! Proof of optimality of a transport plan, independent of the solver that made it.

use super::problem::{OptimalityCertificate, TransportPlan};
use super::problem::{PointWeights, check};
use crate::check::{check_len, check_range};
use crate::error::{ClusterError, Result};

/// Rounding error that the check of a transport plan's optimality allows: a fraction of the whole
/// mass for masses, otherwise of the largest cost or potential in magnitude, whichever is less.
pub const CERTIFICATE_RELATIVE_TOLERANCE: f64 = 1e-12;

/// Largest accepted `gap + violation` of a certificate, by which the transport plan's cost may
/// exceed the optimum, as a fraction of that cost in magnitude. See [`certify_optimality`] for what
/// negative costs and given weights are held to where that cost is close to zero.
pub const MAX_RELATIVE_DUALITY_GAP: f64 = 1e-9;

/// Largest magnitude of a potential that is compared with costs: far beyond those of any plan.
const MAX_POTENTIAL: f64 = 1e300;

/// Buffers for the row and column sums of a transport plan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    sent: Vec<f64>,
    received: Vec<f64>,
}

/// Checks that `plan` is an optimal transport plan for the row-major matrix `cost` `[n, m]`, up to
/// rounding, and returns the precision of the proof.
///
/// With weights `a_i`, `b_j` and potentials `u_i`, `v_j`, linear-programming duality says
///
/// ```text
/// sum_ij gamma_ij c_ij >= sum_i a_i u_i + sum_j b_j v_j
/// ```
///
/// for each plan `gamma` with these marginals and each pair of potentials with
/// `u_i + v_j <= c_ij`. Equality therefore proves that both are optimal. Three facts are checked:
///
/// - the marginals, up to [`CERTIFICATE_RELATIVE_TOLERANCE`];
/// - `u_i + v_j <= c_ij`;
/// - the equality of the two values.
///
/// The last two hold up to [`CERTIFICATE_RELATIVE_TOLERANCE`] times the largest `|c_ij|`, or the
/// largest `|u_i|` or `|v_j|` if that is less, plus the smallest positive `f64` for each point. The
/// plan's own `cost` field is held to the same value.
///
/// With potentials far larger than the cost of the plan, these checks alone would prove nothing. So
/// `gap + violation`, by which the plan's cost may exceed the optimum, must not exceed
/// [`MAX_RELATIVE_DUALITY_GAP`] times `|cost|`. Two kinds of problems are held to
/// [`CERTIFICATE_RELATIVE_TOLERANCE`] times another number if that is more: those with negative
/// costs, which may cancel, to the plan's cost less the least `c_ij`, and those with given weights,
/// whose sums round, to the smallest positive `c_ij` that carries mass.
///
/// Both are measured in twice the precision of an `f64`, since costs far smaller than the
/// potentials would otherwise vanish in them.
///
/// # Errors
/// Errors of [`solve_transport`](crate::solve_transport) about weights and costs, and the first
/// fact that does not hold, with its numbers: [`ClusterError::Imprecise`] for the last of them. NaN
/// anywhere is a failure, never a pass.
pub fn certify_optimality(
    cost: &[f64],
    sources: PointWeights,
    sinks: PointWeights,
    plan: &TransportPlan,
) -> Result<OptimalityCertificate> {
    check(cost, sources, sinks)?;
    certify_into(&mut Scratch::default(), cost, sources, sinks, plan)
}

/// Checks that a transport plan is optimal, as [`certify_optimality`] does, for weights and costs
/// that were checked before; reuses the memory `scratch`.
pub(crate) fn certify_into(
    scratch: &mut Scratch,
    cost: &[f64],
    sources: PointWeights,
    sinks: PointWeights,
    plan: &TransportPlan,
) -> Result<OptimalityCertificate> {
    check_lengths(plan, sources.len(), sinks.len())?;
    let marginal_error = check_marginals(scratch, sources, sinks, plan)?;
    let largest = |values: &[f64]| values.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    let potential = largest(&plan.source_potentials).max(largest(&plan.sink_potentials));
    let scale = potential.min(largest(cost));
    // sums of subnormal numbers are exact, products round to the last bit whatever their size
    let last_bit = f64::from_bits(1) * (sources.len() + sinks.len()) as f64;
    let tolerance = CERTIFICATE_RELATIVE_TOLERANCE * scale + last_bit;
    let violation = check_reduced_costs(cost, plan, tolerance)?;
    let gap = check_gap(cost, sources, sinks, plan, tolerance)?;
    let equal = matches!((sources, sinks), (PointWeights::Uniform(_), PointWeights::Uniform(_)));
    check_precision(cost, plan, equal, gap + violation, last_bit)?;
    Ok(OptimalityCertificate { marginal_error, violation, gap })
}

fn check_lengths(plan: &TransportPlan, n: usize, m: usize) -> Result<()> {
    check_len("the plan's source_potentials", plan.source_potentials.len(), n)?;
    check_len("the plan's sink_potentials", plan.sink_potentials.len(), m)
}

fn check_marginals(
    scratch: &mut Scratch,
    sources: PointWeights,
    sinks: PointWeights,
    plan: &TransportPlan,
) -> Result<f64> {
    let Scratch { sent, received } = scratch;
    for (sums, weights) in [(&mut *sent, sources), (&mut *received, sinks)] {
        sums.clear();
        sums.resize(weights.len(), 0.0);
    }
    for (index, entry) in plan.entries.iter().enumerate() {
        for (name, sums, point) in
            [("source", &mut *sent, entry.source), ("sink", &mut *received, entry.sink)]
        {
            let expected = "an index of the cost matrix";
            check_range(name, point as f64, point < sums.len(), expected)?;
            sums[point] += entry.mass;
        }
        if !at_least(entry.mass, 0.0) {
            let (what, value) = ("entries.mass", entry.mass);
            return Err(ClusterError::Weight { what, index, value });
        }
    }
    let rows = check_side("source", sent, sources)?;
    let columns = check_side("sink", received, sinks)?;
    Ok(rows.max(columns))
}

fn check_side(side: &'static str, carried: &[f64], weights: PointWeights) -> Result<f64> {
    let sum = weights.sum();
    let mut largest = 0.0_f64;
    for (index, &got) in carried.iter().enumerate() {
        let expected = weights.get(index) / sum;
        let error = (got - expected).abs();
        // the comparison must fail for NaN, so it is not written as `error > tolerance`
        if !at_least(CERTIFICATE_RELATIVE_TOLERANCE, error) {
            return Err(ClusterError::Marginal { side, index, got, expected });
        }
        largest = largest.max(error);
    }
    Ok(largest)
}

fn check_reduced_costs(cost: &[f64], plan: &TransportPlan, tolerance: f64) -> Result<f64> {
    let (u, v) = (&plan.source_potentials, &plan.sink_potentials);
    // with larger potentials, slacks may overflow to NaN, which a minimum ignores
    let moderate = u.iter().chain(v).all(|p| p.abs() <= MAX_POTENTIAL);
    let mut least = 0.0_f64;
    for (source_index, (row, potential)) in cost.chunks_exact(v.len()).zip(u).enumerate() {
        let slack = least_slack(row, v, *potential);
        if !(moderate && slack >= -tolerance) {
            refuse(source_index, row, v, *potential, tolerance)?;
        }
        least = least.min(slack);
    }
    Ok(least.abs())
}

/// Returns `c - v - u` as exactly as an `f64` holds it: where potentials are so large that `c`
/// drowns in them, the rounding of `c - v` is all that is left.
#[inline(always)]
fn slack(c: f64, v: f64, u: f64) -> f64 {
    let (rounded, error) = two_sum(c, -v);
    rounded - u + error
}

/// Returns a sum and its rounding error (D. E. Knuth, "The art of computer programming", volume 2,
/// section 4.2.2).
#[inline(always)]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let added = sum - a;
    (sum, (a - (sum - added)) + (b - added))
}

/// Returns the smallest slack `c - v - u` of a row of finite costs, in eight lanes: a single
/// minimum would wait for each comparison in turn.
fn least_slack(row: &[f64], v: &[f64], u: f64) -> f64 {
    let lower = |a: f64, b: f64| if b < a { b } else { a };
    let mut lanes = [f64::INFINITY; 8];
    let ((costs, cost_rest), (vs, v_rest)) = (row.as_chunks::<8>(), v.as_chunks::<8>());
    for (c, sinks) in costs.iter().zip(vs) {
        for k in 0..8 {
            lanes[k] = lower(lanes[k], slack(c[k], sinks[k], u));
        }
    }
    let rest = cost_rest.iter().zip(v_rest).map(|(c, sink)| slack(*c, *sink, u));
    lanes.into_iter().chain(rest).fold(f64::INFINITY, lower)
}

/// Returns an error for the first pair of a row of the cost matrix whose slack `c - v - u` is too
/// small or NaN, if there is one.
fn refuse(source_index: usize, row: &[f64], v: &[f64], u: f64, tolerance: f64) -> Result<()> {
    let slacks = row.iter().zip(v).map(|(c, v)| slack(*c, *v, u));
    match slacks.enumerate().find(|&(_, slack)| !at_least(slack, -tolerance)) {
        Some((sink_index, slack)) => {
            Err(ClusterError::DualInfeasible { source_index, sink_index, slack, tolerance })
        }
        None => Ok(()),
    }
}

fn check_gap(
    cost: &[f64],
    sources: PointWeights,
    sinks: PointWeights,
    plan: &TransportPlan,
    tolerance: f64,
) -> Result<f64> {
    let (primal, slack) = priced(cost, plan);
    let dual = dual(sources, sinks, plan);
    // the plan's own `cost` field is a claim, too
    for value in [primal, plan.cost] {
        if !at_least(tolerance, (value - dual).abs()) {
            return Err(ClusterError::DualityGap { primal: value, dual, tolerance });
        }
    }
    let gaps = [primal - dual, plan.cost - dual, slack];
    Ok(gaps.into_iter().fold(0.0, |top, gap| top.max(gap.abs())))
}

/// Returns the cost of the entries of a transport plan, and the sum of their slacks times their
/// masses. With exact marginals the latter is the duality gap, without the rounding in sums of
/// potentials.
fn priced(cost: &[f64], plan: &TransportPlan) -> (f64, f64) {
    let (mut primal, mut open) = (Sum::default(), 0.0);
    for entry in &plan.entries {
        let c = cost[entry.source * plan.sink_potentials.len() + entry.sink];
        let v = plan.sink_potentials[entry.sink];
        let u = plan.source_potentials[entry.source];
        primal.add_product(entry.mass, c);
        open += entry.mass * slack(c, v, u).abs();
    }
    (primal.value(), open)
}

/// Returns the dual value of a transport plan: the potentials, averaged by the weights.
fn dual(sources: PointWeights, sinks: PointWeights, plan: &TransportPlan) -> f64 {
    let (u, a) = weighted(sources, &plan.source_potentials);
    let (v, b) = weighted(sinks, &plan.sink_potentials);
    // one division at the end: two large quotients that cancel would leave their rounding
    let mut sum = Sum::default();
    for (value, other) in [(u, b), (v, a)] {
        sum.add_product(value.high, other.high);
        sum.add_product(value.high, other.low);
        sum.add_product(value.low, other.high);
    }
    sum.value() / (a.value() * b.value())
}

/// Returns the weighted sum of the potentials of one side (sources or sinks), and the sum of the
/// weights.
fn weighted(weights: PointWeights, potentials: &[f64]) -> (Sum, Sum) {
    let (mut value, mut whole) = (Sum::default(), Sum::default());
    match weights {
        PointWeights::Uniform(points) => {
            potentials.iter().for_each(|p| value.add(*p));
            whole.add(points as f64);
        }
        PointWeights::Given(given) => {
            for (weight, potential) in given.iter().zip(potentials) {
                value.add_product(*weight, *potential);
                whole.add(*weight);
            }
        }
    }
    (value, whole)
}

/// Sum in twice the precision of an `f64`: digits stay correct under cancellation (T. Ogita, S. M.
/// Rump and S. Oishi, "Accurate sum and dot product" (2005)).
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    high: f64,
    low: f64,
}

impl Sum {
    fn add(&mut self, value: f64) {
        let (high, error) = two_sum(self.high, value);
        self.high = high;
        self.low += error;
    }

    fn add_product(&mut self, a: f64, b: f64) {
        let product = a * b;
        self.add(product);
        // a fused multiply-add returns the rounding error of the product exactly
        self.low += a.mul_add(b, -product);
    }

    fn value(self) -> f64 {
        self.high + self.low
    }
}

/// Checks that the cost of a transport plan exceeds the optimum by a small fraction of itself at
/// most.
fn check_precision(
    cost: &[f64],
    plan: &TransportPlan,
    equal: bool,
    excess: f64,
    last_bit: f64,
) -> Result<()> {
    let relative = MAX_RELATIVE_DUALITY_GAP * plan.cost.abs() + last_bit;
    if at_least(relative, excess) {
        return Ok(());
    }
    let tolerance =
        relative.max(CERTIFICATE_RELATIVE_TOLERANCE * scale_near_zero(cost, plan, equal));
    if at_least(tolerance, excess) {
        return Ok(());
    }
    Err(ClusterError::Imprecise { cost: plan.cost, excess, tolerance })
}

/// Returns the size of costs relative to which the cost of a transport plan may be rounding alone:
/// weights that differ in their last bits move some mass, and costs of both signs cancel. Zero if
/// neither is possible.
fn scale_near_zero(cost: &[f64], plan: &TransportPlan, equal: bool) -> f64 {
    let least = cost.iter().fold(0.0_f64, |least, c| least.min(*c));
    if least < 0.0 {
        return plan.cost - least;
    }
    if equal {
        return 0.0;
    }
    let sinks = plan.sink_potentials.len();
    let paid = plan.entries.iter().map(|e| cost[e.source * sinks + e.sink]);
    let smallest = paid.filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 0.0 }
}

/// Returns `value >= bound`, which is `false` for NaN on either side; a negated `<` would be
/// `true`.
fn at_least(value: f64, bound: f64) -> bool {
    value >= bound
}

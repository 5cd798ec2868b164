//! Proof of optimality of a transport plan, independent of the solver that made it.

use super::plan::{Certificate, TransportPlan};
use super::problem::{Weights, check};
use crate::error::{ClusterError, Result};

/// Rounding allowance of a certificate, as a fraction of the largest cost or potential in
/// magnitude, whichever is less (of one, for masses).
pub const RELATIVE_TOLERANCE: f64 = 1e-12;

/// Largest `gap + violation` of a certificate, as a fraction of the plan's cost in magnitude.
pub const COST_TOLERANCE: f64 = 1e-9;

/// Row and column sums of a plan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    sent: Vec<f64>,
    received: Vec<f64>,
}

/// Checks that `plan` is an optimal transport plan for the row-major matrix `cost` `[n, m]`.
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
/// - the marginals, up to [`RELATIVE_TOLERANCE`];
/// - `u_i + v_j <= c_ij`;
/// - the equality of the two values.
///
/// The last two hold up to [`RELATIVE_TOLERANCE`] times the largest `|c_ij|`, or the largest
/// `|u_i|` or `|v_j|` if that is less, plus the smallest positive `f64` for each point. The plan's
/// own `cost` field is held to the same value.
///
/// Potentials far larger than the cost of the plan would make that a proof of nothing. So `gap +
/// violation`, by which the plan's cost may exceed the optimum, must not exceed [`COST_TOLERANCE`]
/// times `|cost|`. Costs of zero or close to it are held to [`RELATIVE_TOLERANCE`] times the
/// smallest positive `c_ij` that carries mass or, where costs are negative and may cancel, times
/// the plan's cost less the least `c_ij`.
///
/// # Errors
/// Those of [`transport`](crate::transport()) about weights and costs, and the first fact that does
/// not hold, with its numbers: [`ClusterError::Imprecise`] for the last of them. NaN anywhere is a
/// failure, never a pass.
pub fn certify(
    cost: &[f64],
    sources: Weights,
    sinks: Weights,
    plan: &TransportPlan,
) -> Result<Certificate> {
    check(cost, sources, sinks)?;
    certify_into(&mut Scratch::default(), cost, sources, sinks, plan)
}

/// [`certify`] for a checked problem, in memory that is kept.
pub(crate) fn certify_into(
    scratch: &mut Scratch,
    cost: &[f64],
    sources: Weights,
    sinks: Weights,
    plan: &TransportPlan,
) -> Result<Certificate> {
    check_lengths(plan, sources.len(), sinks.len())?;
    let marginal_error = check_marginals(scratch, sources, sinks, plan)?;
    let largest = |values: &[f64]| values.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    let potential = largest(&plan.source_potentials).max(largest(&plan.sink_potentials));
    let scale = potential.min(largest(cost));
    // sums of subnormal numbers are exact, products round to the last bit whatever their size
    let last_bit = f64::from_bits(1) * (sources.len() + sinks.len()) as f64;
    let tolerance = RELATIVE_TOLERANCE * scale + last_bit;
    let violation = check_reduced_costs(cost, plan, tolerance)?;
    let gap = check_gap(cost, sources, sinks, plan, tolerance)?;
    check_precision(cost, plan, gap + violation, last_bit)?;
    Ok(Certificate {
        marginal_error,
        violation,
        gap,
    })
}

fn check_lengths(plan: &TransportPlan, n: usize, m: usize) -> Result<()> {
    let parts = [
        ("source_potentials", plan.source_potentials.len(), n),
        ("sink_potentials", plan.sink_potentials.len(), m),
    ];
    match parts.into_iter().find(|(_, got, expected)| got != expected) {
        Some((what, got, expected)) => Err(ClusterError::PlanShape {
            what,
            got,
            expected,
        }),
        None => Ok(()),
    }
}

fn check_marginals(
    scratch: &mut Scratch,
    sources: Weights,
    sinks: Weights,
    plan: &TransportPlan,
) -> Result<f64> {
    let Scratch { sent, received } = scratch;
    for (sums, weights) in [(&mut *sent, sources), (&mut *received, sinks)] {
        sums.clear();
        sums.resize(weights.len(), 0.0);
    }
    for (index, entry) in plan.entries.iter().enumerate() {
        let (Some(row), Some(column)) = (sent.get_mut(entry.source), received.get_mut(entry.sink))
        else {
            return Err(ClusterError::EntryOutOfRange {
                source_index: entry.source,
                sources: sources.len(),
                sink_index: entry.sink,
                sinks: sinks.len(),
            });
        };
        if !at_least(entry.mass, 0.0) {
            let (what, value) = ("entries.mass", entry.mass);
            return Err(ClusterError::NegativeMass { what, index, value });
        }
        *row += entry.mass;
        *column += entry.mass;
    }
    let rows = check_side("source", sent, sources)?;
    let columns = check_side("sink", received, sinks)?;
    Ok(rows.max(columns))
}

fn check_side(side: &'static str, carried: &[f64], weights: Weights) -> Result<f64> {
    let sum = weights.sum();
    let mut largest = 0.0_f64;
    for (index, &got) in carried.iter().enumerate() {
        let expected = weights.get(index) / sum;
        let error = (got - expected).abs();
        if !at_least(RELATIVE_TOLERANCE, error) {
            return Err(ClusterError::Marginal {
                side,
                index,
                got,
                expected,
            });
        }
        largest = largest.max(error);
    }
    Ok(largest)
}

fn check_reduced_costs(cost: &[f64], plan: &TransportPlan, tolerance: f64) -> Result<f64> {
    let (u, v) = (&plan.source_potentials, &plan.sink_potentials);
    let finite = u.iter().chain(v).all(|p| p.is_finite());
    let mut least = 0.0_f64;
    for (source_index, (row, u)) in cost.chunks_exact(v.len()).zip(u).enumerate() {
        let slack = least_slack(row, v, *u);
        if !(finite && slack >= -tolerance) {
            refuse(source_index, row, v, *u, tolerance)?;
        }
        least = least.min(slack);
    }
    Ok(least.abs())
}

/// Returns the smallest `c_j - v_j - u` of finite numbers, in lanes: a single minimum would wait
/// for each comparison in turn.
fn least_slack(row: &[f64], v: &[f64], u: f64) -> f64 {
    let lower = |a: f64, b: f64| if b < a { b } else { a };
    let mut lanes = [f64::INFINITY; 8];
    let ((costs, cost_rest), (vs, v_rest)) = (row.as_chunks::<8>(), v.as_chunks::<8>());
    for (c, v) in costs.iter().zip(vs) {
        for k in 0..8 {
            lanes[k] = lower(lanes[k], c[k] - v[k] - u);
        }
    }
    let rest = cost_rest.iter().zip(v_rest).map(|(c, v)| c - v - u);
    lanes.into_iter().chain(rest).fold(f64::INFINITY, lower)
}

/// Refuses the first pair of a row whose slack is too small or not a number, if there is one.
fn refuse(source_index: usize, row: &[f64], v: &[f64], u: f64, tolerance: f64) -> Result<()> {
    let slacks = row.iter().zip(v).map(|(c, v)| c - v - u);
    match slacks
        .enumerate()
        .find(|&(_, slack)| !at_least(slack, -tolerance))
    {
        Some((sink_index, slack)) => Err(ClusterError::DualInfeasible {
            source_index,
            sink_index,
            slack,
            tolerance,
        }),
        None => Ok(()),
    }
}

fn check_gap(
    cost: &[f64],
    sources: Weights,
    sinks: Weights,
    plan: &TransportPlan,
    tolerance: f64,
) -> Result<f64> {
    let primal = plan.priced(cost);
    let dual = value(sources, &plan.source_potentials) + value(sinks, &plan.sink_potentials);
    for value in [primal, plan.cost] {
        if !at_least(tolerance, (value - dual).abs()) {
            return Err(ClusterError::DualityGap {
                primal: value,
                dual,
                tolerance,
            });
        }
    }
    Ok((primal - dual).abs())
}

/// Checks that the cost of a plan exceeds the optimum by a small part of itself at most.
fn check_precision(cost: &[f64], plan: &TransportPlan, excess: f64, last_bit: f64) -> Result<()> {
    let relative = COST_TOLERANCE * plan.cost.abs() + last_bit;
    if at_least(relative, excess) {
        return Ok(());
    }
    let tolerance = relative.max(RELATIVE_TOLERANCE * scale_near_zero(cost, plan));
    if at_least(tolerance, excess) {
        return Ok(());
    }
    Err(ClusterError::Imprecise {
        cost: plan.cost,
        excess,
        tolerance,
    })
}

/// Returns the size of costs beside which the cost of a plan may be rounding alone: weights that
/// differ in their last bits move some mass, and costs of both signs cancel.
fn scale_near_zero(cost: &[f64], plan: &TransportPlan) -> f64 {
    let least = cost.iter().fold(0.0_f64, |least, c| least.min(*c));
    if least < 0.0 {
        return plan.cost - least;
    }
    let sinks = plan.sink_potentials.len();
    let paid = plan.entries.iter().map(|e| cost[e.source * sinks + e.sink]);
    let smallest = paid.filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 0.0 }
}

/// Returns the mean of the potentials under the weights.
fn value(weights: Weights, potentials: &[f64]) -> f64 {
    let weighted = potentials.iter().enumerate();
    weighted.map(|(i, p)| weights.get(i) * p).sum::<f64>() / weights.sum()
}

/// False for NaN on either side, which a negated `<` would let through.
fn at_least(value: f64, bound: f64) -> bool {
    value >= bound
}

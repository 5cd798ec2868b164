//! Proof of optimality of a transport plan, independent of the solver that made it.

use crate::ClusterError;
use crate::transport::{Supplies, TransportPlan};

/// Rounding allowance of a certificate, as a fraction of the largest cost in magnitude.
pub const RELATIVE_TOLERANCE: f64 = 1e-9;

/// Checks that `plan` is an optimal transport plan for the row-major matrix `cost` `[n, m]`.
///
/// With supplies `a_i`, demands `b_j` and potentials `u_i`, `v_j`, linear-programming duality says
/// `sum_ij gamma_ij c_ij >= sum_i a_i u_i + sum_j b_j v_j` for each plan `gamma` with these
/// marginals and each pair of potentials with `u_i + v_j <= c_ij`. Equality therefore proves that
/// both are optimal. Three facts are checked: the marginals (exactly, in integers), `u_i + v_j <=
/// c_ij` and the equality of the two values, the last two up to [`RELATIVE_TOLERANCE`] times the
/// largest `|c_ij|`. The plan's own `cost` field is held to the same value.
///
/// # Errors
/// The first fact that does not hold, with its numbers. NaN anywhere is a failure, never a pass.
pub fn certify(cost: &[f64], plan: &TransportPlan) -> Result<(), ClusterError> {
    let supplies = Supplies::new(cost, plan.sources, plan.sinks)?;
    check_shapes(plan)?;
    check_marginals(&supplies, plan)?;
    let largest = cost.iter().fold(0.0_f64, |top, c| top.max(c.abs()));
    let tolerance = RELATIVE_TOLERANCE * largest;
    check_reduced_costs(cost, plan, tolerance)?;
    check_gap(cost, plan, tolerance)
}

fn check_shapes(plan: &TransportPlan) -> Result<(), ClusterError> {
    let (u, v) = (&plan.source_potentials, &plan.sink_potentials);
    let parts = [
        ("source_potentials", u.len(), plan.sources),
        ("sink_potentials", v.len(), plan.sinks),
    ];
    for (what, got, expected) in parts {
        if got != expected {
            return Err(ClusterError::PlanShape {
                what,
                got,
                expected,
            });
        }
    }
    Ok(())
}

fn check_marginals(supplies: &Supplies, plan: &TransportPlan) -> Result<(), ClusterError> {
    let (sources, sinks) = (plan.sources, plan.sinks);
    let mut sent = vec![0usize; sources];
    let mut received = vec![0usize; sinks];
    for entry in &plan.entries {
        let (source_index, sink_index) = (entry.source, entry.sink);
        if source_index >= sources || sink_index >= sinks {
            return Err(ClusterError::EntryOutOfRange {
                source_index,
                sources,
                sink_index,
                sinks,
            });
        }
        // saturating: a corrupt plan must be refused, not wrap around into a right sum
        sent[source_index] = sent[source_index].saturating_add(entry.units);
        received[sink_index] = received[sink_index].saturating_add(entry.units);
    }
    check_side("source", &sent, supplies.supply)?;
    check_side("sink", &received, supplies.demand)
}

fn check_side(side: &'static str, carried: &[usize], expected: usize) -> Result<(), ClusterError> {
    match carried.iter().position(|&units| units != expected) {
        Some(index) => Err(ClusterError::Marginal {
            side,
            index,
            got: carried[index],
            expected,
        }),
        None => Ok(()),
    }
}

fn check_reduced_costs(
    cost: &[f64],
    plan: &TransportPlan,
    tolerance: f64,
) -> Result<(), ClusterError> {
    for (source_index, (row, u)) in cost
        .chunks_exact(plan.sinks)
        .zip(&plan.source_potentials)
        .enumerate()
    {
        for (sink_index, (c, v)) in row.iter().zip(&plan.sink_potentials).enumerate() {
            let slack = c - v - u;
            if !at_least(slack, -tolerance) {
                return Err(ClusterError::DualInfeasible {
                    source_index,
                    sink_index,
                    slack,
                    tolerance,
                });
            }
        }
    }
    Ok(())
}

fn check_gap(cost: &[f64], plan: &TransportPlan, tolerance: f64) -> Result<(), ClusterError> {
    let primal = plan.priced(cost);
    let dual = mean(&plan.source_potentials) + mean(&plan.sink_potentials);
    for value in [primal, plan.cost] {
        if !at_least(tolerance, (value - dual).abs()) {
            return Err(ClusterError::DualityGap {
                primal: value,
                dual,
                tolerance,
            });
        }
    }
    Ok(())
}

/// False for NaN on either side, which a negated `<` would let through.
fn at_least(value: f64, bound: f64) -> bool {
    value >= bound
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

//! Optimal transport on a line, in closed form.

use crate::check::rows;
use crate::error::{ClusterError, Result};
use crate::transport::{Balance, MAX_RELATIVE_GAP, Weights, check_weights_of};

/// Units, of 2^60, that each given weight adds to what rounding leaves of a difference of sums:
/// 2^-52 of the whole.
const WEIGHT_ROUNDING: u64 = 1 << 8;

/// Returns the 1-Wasserstein distance between weighted points `x` `[n]` and `y` `[m]` on a line, in
/// their unit.
///
/// `W1 = integral of |F(t) - G(t)| dt` over the two distribution functions (G. Peyre and M. Cuturi,
/// "Computational optimal transport" (2019), equation 2.37), in `O((n + m) log(n + m))`: what
/// [`crate::wasserstein1`] finds for `dim = 1` by solving the linear program.
///
/// # Errors
/// An empty side, values that are not finite, weights that are no distribution, and numbers of
/// weights other than `n` and `m`. [`ClusterError::Imprecise`] where given weights decide the
/// distance by differences that the rounding of their sums explains.
///
/// ```
/// use cluster::{Weights, wasserstein1_line};
///
/// let (three, two) = (Weights::Uniform(3), Weights::Uniform(2));
/// let distance = wasserstein1_line(&[0.0, 1.0, 2.0], three, &[0.0, 2.0], two)?;
/// assert!((distance - 1.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), cluster::ClusterError>(())
/// ```
pub fn wasserstein1_line(x: &[f32], a: Weights, y: &[f32], b: Weights) -> Result<f64> {
    check_weights_of(a, rows("x", x, 1, "point")?, b, rows("y", y, 1, "point")?)?;
    // weights as integers: what is left of a difference of sums would be multiplied by the
    // distance of a point however far
    let mut balance = Balance::default();
    balance.fill(a, b);
    let units = balance.masses.iter().map(|mass| mass.units);
    let signed = units.enumerate().map(|(i, units)| if i < x.len() { units } else { -units });
    let points = x.iter().chain(y).map(|&p| f64::from(p));
    let mut steps: Vec<(f64, i64)> = points.zip(signed).collect();
    steps.sort_by(|(s, _), (t, _)| s.total_cmp(t));
    let rounded = match (a, b) {
        (Weights::Uniform(_), Weights::Uniform(_)) => 0,
        _ => WEIGHT_ROUNDING * steps.len() as u64,
    };
    let (mut difference, mut area, mut unsure) = (0, 0.0, 0.0);
    for pair in steps.windows(2) {
        difference += pair[0].1;
        let part = difference.unsigned_abs() as f64 * (pair[1].0 - pair[0].0);
        area += part;
        if difference.unsigned_abs() <= rounded {
            unsure += part;
        }
    }
    let total = balance.total as f64;
    let (cost, excess) = (area / total, unsure / total);
    let tolerance = MAX_RELATIVE_GAP * cost;
    // equal distributions leave nothing but rounding, some 1e-16 of the distances: that is returned
    if unsure < area && excess > tolerance {
        return Err(ClusterError::Imprecise { cost, excess, tolerance });
    }
    Ok(cost)
}

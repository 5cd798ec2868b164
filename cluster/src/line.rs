//! Optimal transport on a line, in closed form.

use std::iter::zip;

use crate::check::rows;
use crate::error::Result;
use crate::transport::{Weights, check_weights_of};

/// Returns the 1-Wasserstein distance between weighted points `x` `[n]` and `y` `[m]` on a line, in
/// their unit.
///
/// `W1 = integral of |F(t) - G(t)| dt` over the two distribution functions (G. Peyre and M. Cuturi,
/// "Computational optimal transport" (2019), equation 2.37), in `O((n + m) log(n + m))`: what
/// [`crate::wasserstein1`] finds for `dim = 1` by solving the linear program.
///
/// # Errors
/// An empty side, values that are not finite, weights that are no distribution, and numbers of
/// weights other than `n` and `m`.
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
    let mut steps = steps("x", x, a, 1.0)?;
    steps.extend(self::steps("y", y, b, -1.0)?);
    steps.sort_by(|(s, _), (t, _)| s.total_cmp(t));
    let mut difference = 0.0;
    let mut area = 0.0;
    for (step, next) in zip(&steps, steps.iter().skip(1)) {
        difference += step.1;
        area += f64::abs(difference) * (next.0 - step.0);
    }
    Ok(area)
}

/// Returns the places and heights of the steps of one distribution function.
fn steps(
    side: &'static str,
    points: &[f32],
    weights: Weights,
    sign: f64,
) -> Result<Vec<(f64, f64)>> {
    check_weights_of(side, weights, rows(side, points, 1, "point")?)?;
    let sum = weights.sum();
    let height = |i| sign * weights.get(i) / sum;
    Ok(points
        .iter()
        .enumerate()
        .map(|(i, &p)| (f64::from(p), height(i)))
        .collect())
}

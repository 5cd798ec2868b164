//! Euclidean distances and the 1-Wasserstein distance between point clouds.

use crate::ClusterError;
use crate::check::{positive, rows};
use crate::transport::transport;

/// Returns the exact 1-Wasserstein distance between the clouds `x` `[n, dim]` and `y` `[m, dim]`,
/// in their unit.
///
/// `W1(X, Y) = min <gamma, M>_F` over `gamma >= 0` with row sums `1/n` and column sums `1/m`, where
/// `M_il = ||X_i - Y_l||_2`: the distance of Liu et al., "Continual Vision-based Reinforcement
/// Learning with Group Symmetries" (CoRL 2023), section 4.3. Distances are accumulated in `f64`.
/// The result is certified (see [`crate::certify`]); it is zero exactly when both clouds hold the
/// same points in the same proportions, up to the certificate's tolerance.
///
/// # Errors
/// An empty cloud, a length that is not a multiple of `dim`, `dim = 0`, or a value that is not
/// finite.
///
/// ```
/// // of three points the middle one, a third of the mass, goes half to either side
/// let distance = cluster::wasserstein1(&[0.0, 1.0, 2.0], &[0.0, 2.0], 1)?;
/// assert!((distance - 1.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), cluster::ClusterError>(())
/// ```
pub fn wasserstein1(x: &[f32], y: &[f32], dim: usize) -> Result<f64, ClusterError> {
    let (n, m) = check_clouds(x, y, dim)?;
    Ok(transport(&cost_matrix(x, y, dim), n, m)?.cost)
}

/// Returns the Euclidean distances between the points of `x` `[n, dim]` and `y` `[m, dim]`,
/// row-major `[n, m]`.
///
/// # Errors
/// Those of [`wasserstein1`].
pub fn euclidean_costs(x: &[f32], y: &[f32], dim: usize) -> Result<Vec<f64>, ClusterError> {
    check_clouds(x, y, dim)?;
    Ok(cost_matrix(x, y, dim))
}

fn check_clouds(x: &[f32], y: &[f32], dim: usize) -> Result<(usize, usize), ClusterError> {
    positive("dim", dim)?;
    Ok((rows("x", x, dim, "point")?, rows("y", y, dim, "point")?))
}

fn cost_matrix(x: &[f32], y: &[f32], dim: usize) -> Vec<f64> {
    let row = |p| y.chunks_exact(dim).map(move |q| euclidean(p, q));
    x.chunks_exact(dim).flat_map(row).collect()
}

fn euclidean(p: &[f32], q: &[f32]) -> f64 {
    // four sums in flight: a single one would wait for each addition in turn
    let mut sums = [0.0_f64; 4];
    let (p4, p_rest) = p.as_chunks::<4>();
    let (q4, q_rest) = q.as_chunks::<4>();
    for (a, b) in p4.iter().zip(q4) {
        for lane in 0..4 {
            sums[lane] += squared(a[lane], b[lane]);
        }
    }
    let rest: f64 = p_rest
        .iter()
        .zip(q_rest)
        .map(|(&a, &b)| squared(a, b))
        .sum();
    (sums.iter().sum::<f64>() + rest).sqrt()
}

fn squared(a: f32, b: f32) -> f64 {
    let difference = f64::from(a) - f64::from(b);
    difference * difference
}

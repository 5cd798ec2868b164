//! Exact 1-Wasserstein distance between point clouds.

use crate::check::{check_positive, check_rows};
use crate::error::Result;
use crate::euclidean::{EuclideanDistances, euclidean};
use crate::transport::{PointWeights, TransportPlan, TransportSolver, check_weights_of};

/// Returns the exact 1-Wasserstein distance between the clouds `x` `[n, dim]` and `y` `[m, dim]`,
/// of points with equal weights, in the unit of the coordinates.
///
/// `W1(X, Y) = min <gamma, M>_F` over `gamma >= 0` with row sums `1/n` and column sums `1/m`, where
/// `M_il = ||X_i - Y_l||_2`: the distance of Liu et al., "Continual Vision-based Reinforcement
/// Learning with Group Symmetries" (CoRL 2023), section 4.3. The result is certified (see
/// [`crate::certify_optimality`]); it is zero exactly when both clouds hold the same points in the
/// same proportions, up to the certificate's tolerance.
///
/// # Errors
/// An empty cloud, a length that is not a multiple of `dim`, `dim = 0`, or a value that is not
/// finite; [`ClusterError::Imprecise`](crate::ClusterError::Imprecise) where rounding leaves more
/// than [`MAX_RELATIVE_DUALITY_GAP`](crate::MAX_RELATIVE_DUALITY_GAP) of the distance open.
///
/// ```
/// // of three points the middle one, a third of the mass, goes half to either side
/// let distance = cluster::wasserstein1(&[0.0, 1.0, 2.0], &[0.0, 2.0], 1)?;
/// assert!((distance - 1.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), cluster::ClusterError>(())
/// ```
pub fn wasserstein1(x: &[f32], y: &[f32], dim: usize) -> Result<f64> {
    check_positive("dim", dim)?;
    // names in errors are those of the arguments, so they are checked before the sides may change
    // places
    check_rows("x", x, dim, "point")?;
    check_rows("y", y, dim, "point")?;
    // many sources and few sinks are priced faster than the reverse
    let (x, y) = if x.len() < y.len() { (y, x) } else { (x, y) };
    let uniform = |cloud: &[f32]| PointWeights::Uniform(cloud.len() / dim);
    Ok(WassersteinSolver::new().solve((x, uniform(x)), (y, uniform(y)), dim)?.cost)
}

/// 1-Wasserstein distance between two clouds and its gradient in their points.
#[derive(Clone, Debug, PartialEq)]
pub struct WassersteinGradient {
    /// 1-Wasserstein distance ([`wasserstein1`]) between the clouds, up to rounding.
    pub distance: f64,
    /// Derivatives of the distance with respect to the points of the first cloud, `[n, dim]`.
    pub x: Vec<f64>,
    /// Derivatives of the distance with respect to the points of the second cloud, `[m, dim]`.
    pub y: Vec<f64>,
}

/// Returns [`wasserstein1`] of the clouds `x` `[n, dim]` and `y` `[m, dim]` and its gradient with
/// respect to the points of both.
///
/// `W1` is a minimum over plans. By the envelope theorem its gradient is that of the cost of the
/// optimal plan `gamma`, which is kept fixed:
///
/// ```text
/// dW1 / dX_i =  sum_l gamma_il (X_i - Y_l) / ||X_i - Y_l||_2
/// dW1 / dY_l = -sum_i gamma_il (X_i - Y_l) / ||X_i - Y_l||_2
/// ```
///
/// `W1` is not differentiable at every cloud. A pair of equal points contributes zero, one of the
/// subgradients of its distance. Where several plans are optimal, the result is the gradient of the
/// cost of one of them, an upper bound of `W1` that touches it at these clouds.
///
/// # Errors
/// Errors of [`wasserstein1`].
///
/// ```
/// // half of the mass moves from 1 to 3, the other half stays where it is
/// let gradient = cluster::wasserstein1_gradient(&[0.0, 1.0], &[0.0, 3.0], 1)?;
/// assert_eq!((gradient.distance, gradient.x, gradient.y), (1.0, vec![0.0, -0.5], vec![0.0, 0.5]));
/// # Ok::<(), cluster::ClusterError>(())
/// ```
pub fn wasserstein1_gradient(x: &[f32], y: &[f32], dim: usize) -> Result<WassersteinGradient> {
    check_positive("dim", dim)?;
    let uniform = |cloud: &[f32]| PointWeights::Uniform(cloud.len() / dim);
    let mut workspace = WassersteinSolver::new();
    let plan = workspace.solve((x, uniform(x)), (y, uniform(y)), dim)?;
    let (mut by_x, mut by_y) = (vec![0.0; x.len()], vec![0.0; y.len()]);
    for entry in &plan.entries {
        let (i, l) = (entry.source * dim, entry.sink * dim);
        let distance = euclidean(&x[i..i + dim], &y[l..l + dim]);
        if distance == 0.0 {
            continue;
        }
        for d in 0..dim {
            let difference = f64::from(x[i + d]) - f64::from(y[l + d]);
            let pull = entry.mass * (difference / distance);
            by_x[i + d] += pull;
            by_y[l + d] -= pull;
        }
    }
    Ok(WassersteinGradient { distance: plan.cost, x: by_x, y: by_y })
}

/// Solver of the 1-Wasserstein distance between weighted clouds of points, with transport plan,
/// potentials and memory that is reused.
///
/// ```
/// use cluster::{PointWeights, WassersteinSolver};
///
/// let mut workspace = WassersteinSolver::new();
/// let (x, y) = ([0.0, 1.0], [0.0, 3.0]);
/// let (a, b) = (PointWeights::Given(&[0.25, 0.75]), PointWeights::Uniform(2));
/// let plan = workspace.solve((&x, a), (&y, b), 1)?;
/// // a quarter moves from 1 to 0, a half from 1 to 3
/// assert_eq!(plan.cost, 0.25 * 1.0 + 0.5 * 2.0);
/// # Ok::<(), cluster::ClusterError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct WassersteinSolver {
    costs: EuclideanDistances,
    solver: TransportSolver,
}

impl WassersteinSolver {
    /// Creates a solver of Wasserstein distances that has allocated nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the optimal transport plan from the weighted cloud `x` `[n, dim]` to the weighted
    /// cloud `y` `[m, dim]`; faster with the larger cloud as `x`.
    ///
    /// # Errors
    /// Errors of [`wasserstein1`], weights that are no distribution, and numbers of weights other
    /// than `n` and `m`.
    pub fn solve(
        &mut self,
        x: WeightedCloud,
        y: WeightedCloud,
        dim: usize,
    ) -> Result<&TransportPlan> {
        let ((x, a), (y, b)) = (x, y);
        let costs = self.costs.compute(x, y, dim)?;
        check_weights_of(a, x.len() / dim, b, y.len() / dim)?;
        self.solver.solve(costs, a, b)
    }
}

/// Points of a cloud, `[n, dim]` for n points of `dim` coordinates, and their weights.
pub type WeightedCloud<'a> = (&'a [f32], PointWeights<'a>);

//! Euclidean distances between the points of two clouds.

use std::iter::zip;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::Arch;
use rayon::prelude::*;

use crate::check::{check_positive, check_rows};
use crate::error::{ClusterError, Result};

/// Fraction of the squared norms of two points below which their squared distance is computed from
/// differences, since the product has lost more than three digits to cancellation.
const CANCELLED: f64 = 1e-3;

/// Number of rows of the distance matrix that one matrix product computes: they stay in the
/// second-level cache.
const BLOCK_ROWS: usize = 64;

/// Number of multiplications of a distance matrix below which a second thread does not pay.
const PARALLEL: usize = 1 << 22;

/// Calculator of the Euclidean distances between the points of two clouds, with one matrix that
/// each call of [`compute`](Self::compute) overwrites.
///
/// `||x - y||^2 = ||x||^2 + ||y||^2 - 2 <x, y>` turns the distances into one matrix product (faer),
/// around the common centre of both clouds. Where the three terms cancel, the distance is computed
/// from the differences: equal points are exactly 0 apart, and relative errors stay below 1e-12.
/// Points are `f32`, everything else is `f64`.
#[derive(Clone, Debug, Default)]
pub struct EuclideanDistances {
    centre: Vec<f64>,
    y: Centred,
    /// Centred points of `x` whose distances are being computed.
    block: Centred,
    costs: Vec<f64>,
}

impl EuclideanDistances {
    /// Creates a calculator of distances that has allocated no memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the Euclidean distances between the points of `x` `[n, dim]` and `y` `[m, dim]`,
    /// row-major `[n, m]`.
    ///
    /// Large matrices are computed on the threads of the current rayon pool; the bits do not depend
    /// on their number.
    ///
    /// # Errors
    /// An empty cloud, a length that is not a multiple of `dim`, `dim = 0`, or a value that is not
    /// finite; a matrix that does not fit in memory.
    pub fn compute(&mut self, x: &[f32], y: &[f32], dim: usize) -> Result<&[f64]> {
        check_positive("dim", dim)?;
        check_rows("x", x, dim, "point")?;
        check_rows("y", y, dim, "point")?;
        let (n, m) = (x.len() / dim, y.len() / dim);
        let Self { centre, costs, .. } = self;
        costs.clear();
        let room = n.checked_mul(m).map(|len| costs.try_reserve(len));
        if !matches!(room, Some(Ok(()))) {
            let (points, others) = (n, m);
            return Err(ClusterError::TooManyPoints { points, others });
        }
        centre.clear();
        centre.resize(dim, 0.0);
        Arch::new().dispatch(
            #[inline(always)]
            || add_points(centre, x, y),
        );
        centre.iter_mut().for_each(|c| *c /= (n + m) as f64);
        self.y.fill(y, centre);
        costs.resize(n * m, 0.0);
        let columns = Columns { centre, centred: &self.y, points: y };
        let (points, rows) = (BLOCK_ROWS * dim, BLOCK_ROWS * m);
        if n * m * dim > PARALLEL {
            let blocks = costs.par_chunks_mut(rows).zip(x.par_chunks(points));
            blocks.for_each_init(Centred::default, |block, (block_costs, block_x)| {
                columns.distances(block, block_x, block_costs);
            });
        } else {
            let blocks = costs.chunks_mut(rows).zip(x.chunks(points));
            blocks.for_each(|(block_costs, block_x)| {
                columns.distances(&mut self.block, block_x, block_costs)
            });
        }
        Ok(&self.costs)
    }
}

#[inline(always)]
fn add_points(sum: &mut [f64], x: &[f32], y: &[f32]) {
    for point in x.chunks_exact(sum.len()).chain(y.chunks_exact(sum.len())) {
        zip(&mut *sum, point).for_each(|(sum, &p)| *sum += f64::from(p));
    }
}

/// Points of a cloud relative to a centre, with their squared norms.
#[derive(Clone, Debug, Default)]
struct Centred {
    points: Vec<f64>,
    norms: Vec<f64>,
}

impl Centred {
    fn fill(&mut self, cloud: &[f32], centre: &[f64]) {
        self.points.clear();
        self.points.resize(cloud.len(), 0.0);
        self.norms.clear();
        let rows =
            zip(self.points.chunks_exact_mut(centre.len()), cloud.chunks_exact(centre.len()));
        Arch::new().dispatch(
            #[inline(always)]
            || self.norms.extend(rows.map(|(row, point)| centred_row(row, point, centre))),
        );
    }
}

/// Writes a point relative to the centre and returns its squared norm.
#[inline(always)]
fn centred_row(row: &mut [f64], point: &[f32], centre: &[f64]) -> f64 {
    for (out, (&p, c)) in zip(&mut *row, zip(point, centre)) {
        *out = f64::from(p) - c;
    }
    // sums in flight: a single one would wait for each addition in turn
    let mut sums = [0.0; 8];
    let (blocks, rest) = row.as_chunks::<8>();
    for block in blocks {
        zip(&mut sums, block).for_each(|(sum, p)| *sum += p * p);
    }
    sums.iter().sum::<f64>() + rest.iter().map(|p| p * p).sum::<f64>()
}

/// Points `y` to which distances are computed, the columns of the distance matrix.
#[derive(Clone, Copy)]
struct Columns<'a> {
    centre: &'a [f64],
    centred: &'a Centred,
    points: &'a [f32],
}

impl Columns<'_> {
    /// Writes the rows `[n, m]` of distances from the points `x` `[n, dim]`.
    fn distances(self, block: &mut Centred, x: &[f32], costs: &mut [f64]) {
        let (dim, norms) = (self.centre.len(), &self.centred.norms);
        let (n, m) = (x.len() / dim, norms.len());
        block.fill(x, self.centre);
        matmul(
            MatMut::from_row_major_slice_mut(costs, n, m),
            Accum::Replace,
            MatRef::from_row_major_slice(&block.points, n, dim),
            MatRef::from_row_major_slice(&self.centred.points, m, dim).transpose(),
            -2.0,
            Par::Seq,
        );
        let arch = Arch::new();
        for ((row, &own), p) in
            zip(zip(costs.chunks_exact_mut(m), &block.norms), x.chunks_exact(dim))
        {
            let cancelled = arch.dispatch(
                #[inline(always)]
                || finish_row(row, own, norms),
            );
            if cancelled {
                mend_row(row, own, p, norms, self.points);
            }
        }
    }
}

/// Turns scalar products into distances, in place; returns `true` if some have lost digits to
/// cancellation.
#[inline(always)]
fn finish_row(row: &mut [f64], own: f64, norms: &[f64]) -> bool {
    let mut cancelled = false;
    for (c, norm) in zip(row, norms) {
        let sum = own + norm;
        let squared = *c + sum;
        cancelled |= squared <= CANCELLED * sum;
        *c = if squared > 0.0 { squared } else { 0.0 }.sqrt();
    }
    cancelled
}

fn mend_row(row: &mut [f64], own: f64, p: &[f32], norms: &[f64], y: &[f32]) {
    for ((c, norm), q) in zip(zip(row, norms), y.chunks_exact(p.len())) {
        // twice the bound, since the root was rounded: what is well conditioned may be mended too
        if *c * *c <= 2.0 * CANCELLED * (own + norm) {
            *c = euclidean(p, q);
        }
    }
}

/// Returns the Euclidean distance between two points, computed from the differences of coordinates.
pub(crate) fn euclidean(p: &[f32], q: &[f32]) -> f64 {
    let squared = |(&a, &b)| {
        let difference = f64::from(a) - f64::from(b);
        difference * difference
    };
    zip(p, q).map(squared).sum::<f64>().sqrt()
}

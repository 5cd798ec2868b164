//! Euclidean distances between the points of two clouds.

use std::iter::zip;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::Arch;
use rayon::prelude::*;

use crate::ClusterError;
use crate::check::{positive, rows};

/// A squared distance below this fraction of the squared norms has lost more than three digits to
/// cancellation and is computed from the differences instead.
const CANCELLED: f64 = 1e-3;

/// Rows of the matrix that one product makes: they stay in the second-level cache.
const BLOCK_ROWS: usize = 64;

/// Multiplications below which a second thread does not pay.
const PARALLEL: usize = 1 << 22;

/// A matrix of distances, with memory that is kept.
///
/// `||x - y||^2 = ||x||^2 + ||y||^2 - 2 <x, y>` turns the distances into one matrix product (faer), around
/// the common centre of both clouds. Where the three terms cancel, the distance is computed from the differences:
/// equal points are exactly 0 apart, and relative errors stay below 1e-12. Points are `f32`, everything else
/// is `f64`.
#[derive(Clone, Debug, Default)]
pub struct EuclideanCosts {
    centre: Vec<f64>,
    x: Centred,
    y: Centred,
    costs: Vec<f64>,
}

/// A cloud around a centre.
#[derive(Clone, Debug, Default)]
struct Centred {
    points: Vec<f64>,
    norms: Vec<f64>,
}

impl EuclideanCosts {
    /// Makes a matrix that has no memory yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the distances between the points of `x` `[n, dim]` and `y` `[m, dim]`, row-major `[n, m]`.
    ///
    /// Large matrices are computed on the threads of the current rayon pool; the bits do not depend on their number.
    ///
    /// # Errors
    /// An empty cloud, a length that is not a multiple of `dim`, `dim = 0`, or a value that is not
    /// finite; a matrix that does not fit in memory.
    pub fn compute(&mut self, x: &[f32], y: &[f32], dim: usize) -> Result<&[f64], ClusterError> {
        positive("dim", dim)?;
        let (n, m) = (rows("x", x, dim, "point")?, rows("y", y, dim, "point")?);
        self.costs.clear();
        let room = n.checked_mul(m).map(|len| self.costs.try_reserve(len));
        if !matches!(room, Some(Ok(()))) {
            let (points, others) = (n, m);
            return Err(ClusterError::TooManyPoints { points, others });
        }
        self.centre.clear();
        self.centre.resize(dim, 0.0);
        for point in x.chunks_exact(dim).chain(y.chunks_exact(dim)) {
            zip(&mut self.centre, point).for_each(|(c, &p)| *c += f64::from(p) / (n + m) as f64);
        }
        self.x.fill(x, &self.centre);
        self.y.fill(y, &self.centre);
        self.costs.resize(n * m, 0.0);
        let (cx, cy) = (&self.x, &self.y);
        let block = |(index, costs): (usize, &mut [f64])| {
            distances(costs, index * BLOCK_ROWS, (cx, x), (cy, y), dim);
        };
        let blocks = BLOCK_ROWS * m;
        match n * m * dim > PARALLEL {
            true => self
                .costs
                .par_chunks_mut(blocks)
                .enumerate()
                .for_each(block),
            false => self.costs.chunks_mut(blocks).enumerate().for_each(block),
        }
        Ok(&self.costs)
    }
}

impl Centred {
    fn fill(&mut self, cloud: &[f32], centre: &[f64]) {
        self.points.clear();
        self.norms.clear();
        for point in cloud.chunks_exact(centre.len()) {
            let centred = zip(point, centre).map(|(&p, c)| f64::from(p) - c);
            let start = self.points.len();
            self.points.extend(centred);
            self.norms
                .push(self.points[start..].iter().map(|p| p * p).sum());
        }
    }
}

/// Writes the rows from `first` on.
fn distances(
    costs: &mut [f64],
    first: usize,
    (cx, x): (&Centred, &[f32]),
    (cy, y): (&Centred, &[f32]),
    dim: usize,
) {
    let m = cy.norms.len();
    let n = costs.len() / m;
    let left = &cx.points[first * dim..(first + n) * dim];
    matmul(
        MatMut::from_row_major_slice_mut(costs, n, m),
        Accum::Replace,
        MatRef::from_row_major_slice(left, n, dim),
        MatRef::from_row_major_slice(&cy.points, m, dim).transpose(),
        -2.0,
        Par::Seq,
    );
    let arch = Arch::new();
    for (i, row) in costs.chunks_exact_mut(m).enumerate() {
        let own = cx.norms[first + i];
        let cancelled = arch.dispatch(
            #[inline(always)]
            || finish_row(row, own, &cy.norms),
        );
        if cancelled {
            let p = &x[(first + i) * dim..][..dim];
            mend_row(row, own, p, &cy.norms, y);
        }
    }
}

/// Turns products into distances; returns whether some have cancelled.
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

fn euclidean(p: &[f32], q: &[f32]) -> f64 {
    let squared = |(&a, &b)| {
        let difference = f64::from(a) - f64::from(b);
        difference * difference
    };
    zip(p, q).map(squared).sum::<f64>().sqrt()
}

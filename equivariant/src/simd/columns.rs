//! Weight gradients of first layers: every column of the lines by itself.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over constants that index several arrays of registers"
)]

use crate::real::Real;
use crate::simd::join::head;
use crate::simd::lanes::{Block, Lanes};
use crate::simd::lines::G;

/// The operands of the weight gradient of a line.
pub(crate) struct Columns<'a, T, L> {
    pub lanes: L,
    /// Blocks of an output pixel.
    pub width: usize,
    /// From the window of an output pixel to the next.
    pub step: usize,
    pub x: &'a [T],
    pub dy: &'a [Block<T>],
    /// The first block of dy.
    pub first: usize,
}

impl<T: Real, L: Lanes<T>> Columns<'_, T, L> {
    /// V blocks of all columns, K of them at a time.
    #[inline(always)]
    pub fn all<const K: usize, const V: usize>(
        &self,
        columns: usize,
        dw: &mut [Block<T>],
    ) -> usize {
        let whole = columns / K * K;
        for column in (0..whole).step_by(K) {
            self.sum::<K, V>(column, dw);
        }
        for column in whole..columns {
            self.sum::<1, V>(column, dw);
        }
        V
    }

    #[inline(always)]
    fn sum<const K: usize, const V: usize>(&self, column: usize, dw: &mut [Block<T>]) {
        let Columns {
            lanes, width, step, ..
        } = *self;
        let rows = self.dy.len() / width;
        let mut dy = [&self.dy[..rows]; V];
        for v in 0..V {
            dy[v] = &self.dy[(self.first + v) * rows..][..rows];
        }
        let mut sums = [[lanes.splat(T::ZERO); V]; K];
        for r in 0..rows {
            let x: &[[T; G]; K] = head(self.x[r * step + column * G..].as_chunks().0);
            for v in 0..V {
                let d = lanes.load(&dy[v][r]);
                for k in 0..K {
                    sums[k][v] = lanes.mul_add(lanes.quad(&x[k]), d, sums[k][v]);
                }
            }
        }
        for k in 0..K {
            for v in 0..V {
                let dw = &mut dw[(column + k) * width + self.first + v];
                lanes.store(dw, lanes.add(lanes.load(dw), sums[k][v]));
            }
        }
    }
}

//! Inner loops of the matrix products: tiles of sums that stay in registers.
//!
//! One lane is one (field, irrep) of the result. A factor that all fields share is a group of G
//! lanes, one for each irrep, repeated over the block. So one product serves all the irreps at
//! once, and narrow layers fill the registers as well as wide ones.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over constants that index several arrays of registers"
)]

use crate::real::Real;
use crate::simd::interleave::first_n;
use crate::simd::lanes::{Block, LANES, Lanes};

/// Number of rows (output pixels) of an im2col panel in the forward pass: 12 rows of two blocks are
/// 24 sums, which fit into 32 registers.
pub(crate) const PANEL_ROWS: usize = 12;

/// Loads N blocks into registers. A plain loop, because a closure would not be compiled for the
/// instruction set.
#[inline(always)]
pub(crate) fn load_blocks<T: Real, L: Lanes<T>, const N: usize>(
    lanes: L,
    blocks: &[Block<T>; N],
) -> [L::V; N] {
    let mut values = [lanes.splat(T::ZERO); N];
    for (value, block) in values.iter_mut().zip(blocks) {
        *value = lanes.load(block);
    }
    values
}

/// Writes the matrix product y = x w for the first `rows` of [`PANEL_ROWS`] rows; x is a panel
/// `[block][row]`, w `[group of x][block of y]`, y `[row][block]`.
#[inline(always)]
pub(crate) fn panel_product<T: Real, L: Lanes<T>, const G: usize>(
    lanes: L,
    x: &[[Block<T>; PANEL_ROWS]],
    w: &[Block<T>],
    y: &mut [Block<T>],
    rows: usize,
) {
    let width = y.len() / PANEL_ROWS;
    let mut first = 0;
    while first < width {
        let tile = Tile { w, width, first };
        // Weights come from the second-level cache, so a tile reads them once for all of its rows.
        first += match (L::REGISTERS, width - first) {
            (32.., 2..) if rows == PANEL_ROWS => {
                forward_tiles::<T, L, G, PANEL_ROWS, 2>(lanes, x, rows, tile, y)
            }
            (32.., _) if rows == PANEL_ROWS => {
                forward_tiles::<T, L, G, PANEL_ROWS, 1>(lanes, x, rows, tile, y)
            }
            (32.., 2..) => forward_tiles::<T, L, G, 4, 2>(lanes, x, rows, tile, y),
            (8..32, _) => forward_tiles::<T, L, G, 6, 1>(lanes, x, rows, tile, y),
            (..8, 2..) => forward_tiles::<T, L, G, 2, 2>(lanes, x, rows, tile, y),
            _ => forward_tiles::<T, L, G, 4, 1>(lanes, x, rows, tile, y),
        };
    }
}

/// Columns of the packed weights `[lane group][width]`, from block `first` on.
#[derive(Clone, Copy)]
struct Tile<'a, T> {
    w: &'a [Block<T>],
    width: usize,
    first: usize,
}

/// Writes V blocks of the matrix product for the first `rows` rows, R rows at a time, and returns
/// V. The last tile may write more rows.
#[inline(always)]
fn forward_tiles<T: Real, L: Lanes<T>, const G: usize, const R: usize, const V: usize>(
    lanes: L,
    x: &[[Block<T>; PANEL_ROWS]],
    rows: usize,
    tile: Tile<T>,
    y: &mut [Block<T>],
) -> usize {
    for row in (0..rows).step_by(R) {
        forward_tile::<T, L, G, R, V>(lanes, x, row, tile, y);
    }
    V
}

/// Writes V blocks of the matrix product for R rows.
#[inline(always)]
fn forward_tile<T: Real, L: Lanes<T>, const G: usize, const R: usize, const V: usize>(
    lanes: L,
    x: &[[Block<T>; PANEL_ROWS]],
    row: usize,
    tile: Tile<T>,
    y: &mut [Block<T>],
) {
    let mut sums = [[lanes.splat(T::ZERO); V]; R];
    let groups = LANES / G;
    let mut ws = tile.w.chunks_exact(groups * tile.width);
    for panel in x {
        let Some(w) = ws.next() else { break };
        let panel: &[Block<T>; R] = first_n(&panel[row..]);
        for g in 0..groups {
            let w: &[Block<T>; V] = first_n(&w[g * tile.width + tile.first..]);
            let w = load_blocks(lanes, w);
            for r in 0..R {
                let panel = lanes.broadcast_group::<G>(&panel[r], g);
                for v in 0..V {
                    sums[r][v] = lanes.mul_add(panel, w[v], sums[r][v]);
                }
            }
        }
    }
    for (r, row_sums) in sums.iter().enumerate() {
        let y = &mut y[(row + r) * tile.width + tile.first..][..V];
        for (out, &sum) in y.iter_mut().zip(row_sums) {
            lanes.store(out, sum);
        }
    }
}

/// Adds the weight gradient x^T dy, summed over all rows, to dw; x and dy are panels
/// `[block][row]`, dw is `[group of x][block of y]` with `step` blocks from one block of x to the
/// next.
#[inline(always)]
pub(crate) fn add_weight_gradient<T: Real, L: Lanes<T>, const G: usize>(
    lanes: L,
    x: &[Block<T>],
    dy: &[Block<T>],
    rows: usize,
    dw: &mut [Block<T>],
    step: usize,
) {
    let tile = GradientTile { x, dy, rows, step, width: dy.len() / rows };
    let mut first = 0;
    while first < tile.width {
        let wide = L::REGISTERS >= 32;
        // Sixteen independent sums hide the latency of the additions.
        first += match (G, tile.width - first) {
            (4, 4..) if wide => tile.blocks::<L, G, 1, 4, 4>(lanes, first, dw),
            (4, 2..) if wide => tile.blocks::<L, G, 2, 4, 2>(lanes, first, dw),
            (4, _) if wide => tile.blocks::<L, G, 4, 4, 1>(lanes, first, dw),
            (2, 2..) if wide => tile.blocks::<L, G, 1, 8, 2>(lanes, first, dw),
            (2, _) if wide => tile.blocks::<L, G, 2, 8, 1>(lanes, first, dw),
            (1, _) if wide => tile.blocks::<L, G, 1, 16, 1>(lanes, first, dw),
            _ => tile.blocks::<L, G, 1, 4, 1>(lanes, first, dw),
        };
    }
}

/// Operands of a convolution's weight gradient.
#[derive(Clone, Copy)]
struct GradientTile<'a, T> {
    x: &'a [Block<T>],
    dy: &'a [Block<T>],
    rows: usize,
    width: usize,
    step: usize,
}

impl<T: Real> GradientTile<'_, T> {
    /// Adds V blocks of outputs of the weight gradient for all blocks of x, and returns V. B blocks
    /// of x are processed at a time as far as possible, and K groups at a time.
    #[inline(always)]
    fn blocks<L: Lanes<T>, const G: usize, const B: usize, const K: usize, const V: usize>(
        self,
        lanes: L,
        first: usize,
        dw: &mut [Block<T>],
    ) -> usize {
        let blocks = self.x.len() / self.rows;
        let mut block = 0;
        while block < blocks {
            for group in (0..LANES / G).step_by(K) {
                if blocks - block >= B {
                    self.sum::<L, G, B, K, V>(lanes, block, group, first, dw);
                } else {
                    self.sum::<L, G, 1, K, V>(lanes, block, group, first, dw);
                }
            }
            block += if blocks - block >= B { B } else { 1 };
        }
        V
    }

    /// Adds the weight gradient of B blocks of x, K groups of lanes and V blocks of outputs.
    #[inline(always)]
    fn sum<L: Lanes<T>, const G: usize, const B: usize, const K: usize, const V: usize>(
        self,
        lanes: L,
        block: usize,
        group: usize,
        first: usize,
        dw: &mut [Block<T>],
    ) {
        let GradientTile { rows, width, step, .. } = self;
        let (mut x, mut dy) = ([&self.x[..rows]; B], [&self.dy[..rows]; V]);
        for b in 0..B {
            x[b] = &self.x[(block + b) * rows..][..rows];
        }
        for v in 0..V {
            dy[v] = &self.dy[(first + v) * rows..][..rows];
        }
        let at = |b: usize, k: usize| (block + b) * step + (group + k) * width + first;
        let mut sums = [[[lanes.splat(T::ZERO); V]; K]; B];
        for r in 0..rows {
            let mut d = [lanes.splat(T::ZERO); V];
            for v in 0..V {
                d[v] = lanes.load(&dy[v][r]);
            }
            for b in 0..B {
                for k in 0..K {
                    let x = lanes.broadcast_group::<G>(&x[b][r], group + k);
                    for v in 0..V {
                        sums[b][k][v] = lanes.mul_add(x, d[v], sums[b][k][v]);
                    }
                }
            }
        }
        for b in 0..B {
            for k in 0..K {
                let dw = &mut dw[at(b, k)..][..V];
                for v in 0..V {
                    let sum = lanes.add(lanes.load(&dw[v]), sums[b][k][v]);
                    lanes.store(&mut dw[v], sum);
                }
            }
        }
    }
}

/// Returns the gradient with respect to N folds (signed sums of taps) of R output pixels: the
/// product of the output gradient dy `[block][row]` with the weights w `[group of dy][N]`.
#[inline(always)]
pub(crate) fn fold_gradients<
    T: Real,
    L: Lanes<T>,
    const G: usize,
    const R: usize,
    const N: usize,
>(
    lanes: L,
    dy: &[Block<T>],
    rows: usize,
    row: usize,
    w: &[Block<T>],
) -> [[L::V; N]; R] {
    let mut sums = [[lanes.splat(T::ZERO); N]; R];
    let groups = LANES / G;
    let mut ws = w.chunks_exact(groups * N);
    for panel in dy.chunks_exact(rows) {
        let Some(weights) = ws.next() else { break };
        let panel: &[Block<T>; R] = first_n(&panel[row..]);
        // An iterator: indexing takes registers that the loop does not have.
        for (g, block) in weights.as_chunks::<N>().0.iter().enumerate() {
            let block = load_blocks(lanes, block);
            for r in 0..R {
                let d = lanes.broadcast_group::<G>(&panel[r], g);
                for i in 0..N {
                    sums[r][i] = lanes.mul_add(d, block[i], sums[r][i]);
                }
            }
        }
    }
    sums
}

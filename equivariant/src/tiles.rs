//! The inner loops of the matrix products: tiles of sums that stay in registers.
//!
//! One lane is one (field, irrep) of the result. A factor that all fields share is a group of G lanes,
//! one for each irrep, repeated over the block: so one product serves all the irreps at once, and
//! narrow layers fill the registers as well as wide ones.

use crate::join::head;
use crate::lanes::{Block, LANES, Lanes};
use crate::Scalar;

/// Rows of the panels of a forward pass.
pub(crate) const ROWS: usize = 8;

/// Loads in a plain loop: a closure would not be compiled for the instruction set.
#[inline(always)]
fn load_all<T: Scalar, L: Lanes<T>, const N: usize>(lanes: L, blocks: &[Block<T>; N]) -> [L::V; N] {
    let mut values = [lanes.splat(T::ZERO); N];
    for (value, block) in values.iter_mut().zip(blocks) {
        *value = lanes.load(block);
    }
    values
}

/// y = x w for ROWS rows; x is a panel `[block][row]`, w `[group of x][block of y]`, y `[row][block]`.
#[inline(always)]
pub(crate) fn forward<T: Scalar, L: Lanes<T>, const G: usize>(
    lanes: L,
    x: &[[Block<T>; ROWS]],
    w: &[Block<T>],
    y: &mut [Block<T>],
) {
    let width = y.len() / ROWS;
    let mut first = 0;
    while first < width {
        let tile = Tile { w, width, first };
        let left = width - first;
        if left >= 4 && L::REGISTERS >= 32 {
            for row in (0..ROWS).step_by(4) {
                forward_tile::<T, L, G, 4, 4>(lanes, x, row, tile, y);
            }
            first += 4;
        } else if left >= 2 && L::REGISTERS >= 32 {
            forward_tile::<T, L, G, 8, 2>(lanes, x, 0, tile, y);
            first += 2;
        } else if left >= 2 {
            for row in (0..ROWS).step_by(2) {
                forward_tile::<T, L, G, 2, 2>(lanes, x, row, tile, y);
            }
            first += 2;
        } else if L::REGISTERS >= 32 {
            forward_tile::<T, L, G, 8, 1>(lanes, x, 0, tile, y);
            first += 1;
        } else {
            for row in (0..ROWS).step_by(4) {
                forward_tile::<T, L, G, 4, 1>(lanes, x, row, tile, y);
            }
            first += 1;
        }
    }
}

/// Some columns of the weights `[group][width]`.
#[derive(Clone, Copy)]
struct Tile<'a, T> {
    w: &'a [Block<T>],
    width: usize,
    first: usize,
}

#[inline(always)]
fn forward_tile<T: Scalar, L: Lanes<T>, const G: usize, const R: usize, const V: usize>(
    lanes: L,
    x: &[[Block<T>; ROWS]],
    row: usize,
    tile: Tile<T>,
    y: &mut [Block<T>],
) {
    let mut sums = [[lanes.splat(T::ZERO); V]; R];
    let groups = LANES / G;
    for (x, w) in x.iter().zip(tile.w.chunks_exact(groups * tile.width)) {
        let x: &[Block<T>; R] = head(&x[row..]);
        for g in 0..groups {
            let w: &[Block<T>; V] = head(&w[g * tile.width + tile.first..]);
            let w = load_all(lanes, w);
            for r in 0..R {
                let x = lanes.group::<G>(&x[r], g);
                for v in 0..V {
                    sums[r][v] = lanes.mul_add(x, w[v], sums[r][v]);
                }
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let y = &mut y[(row + r) * tile.width + tile.first..][..V];
        for (y, &sum) in y.iter_mut().zip(sums) {
            lanes.store(y, sum);
        }
    }
}

/// dw += x^T dy over all rows; x is a panel `[block][row]`, dy `[block][row]`, dw `[group of x][block of y]`.
#[inline(always)]
pub(crate) fn weights<T: Scalar, L: Lanes<T>, const G: usize>(
    lanes: L,
    x: &[Block<T>],
    dy: &[Block<T>],
    rows: usize,
    dw: &mut [Block<T>],
) {
    let width = dy.len() / rows;
    let groups = LANES / G;
    for (x, dw) in x.chunks_exact(rows).zip(dw.chunks_exact_mut(groups * width)) {
        let mut first = 0;
        while first < width {
            let dy = &dy[first * rows..];
            let left = width - first;
            match (G, L::REGISTERS >= 32) {
                (4, true) if left >= 4 => {
                    weights_tile::<T, L, G, 4, 4>(lanes, x, dy, 0, width, &mut dw[first..]);
                    first += 4;
                }
                (4, true) if left >= 2 => {
                    weights_tile::<T, L, G, 4, 2>(lanes, x, dy, 0, width, &mut dw[first..]);
                    first += 2;
                }
                (2, true) if left >= 2 => {
                    weights_tile::<T, L, G, 8, 2>(lanes, x, dy, 0, width, &mut dw[first..]);
                    first += 2;
                }
                (1, true) => {
                    weights_tile::<T, L, G, 16, 1>(lanes, x, dy, 0, width, &mut dw[first..]);
                    first += 1;
                }
                _ => {
                    for group in (0..groups).step_by(4) {
                        weights_tile::<T, L, G, 4, 1>(lanes, x, dy, group, width, &mut dw[first..]);
                    }
                    first += 1;
                }
            }
        }
    }
}

#[inline(always)]
fn weights_tile<T: Scalar, L: Lanes<T>, const G: usize, const K: usize, const V: usize>(
    lanes: L,
    x: &[Block<T>],
    dy: &[Block<T>],
    group: usize,
    width: usize,
    dw: &mut [Block<T>],
) {
    let rows = x.len();
    let dy: [&[Block<T>]; V] = std::array::from_fn(|v| &dy[v * rows..][..rows]);
    let mut sums = [[lanes.splat(T::ZERO); V]; K];
    for k in 0..K {
        sums[k] = load_all(lanes, head(&dw[(group + k) * width..]));
    }
    for r in 0..rows {
        let mut d = [lanes.splat(T::ZERO); V];
        for v in 0..V {
            d[v] = lanes.load(&dy[v][r]);
        }
        for k in 0..K {
            let x = lanes.group::<G>(&x[r], group + k);
            for v in 0..V {
                sums[k][v] = lanes.mul_add(x, d[v], sums[k][v]);
            }
        }
    }
    for k in 0..K {
        for v in 0..V {
            lanes.store(&mut dw[(group + k) * width + v], sums[k][v]);
        }
    }
}

/// The gradient of N folds in R rows: sums over the groups of dy `[block][row]`, w `[group of dy][N]`.
#[inline(always)]
pub(crate) fn input<T: Scalar, L: Lanes<T>, const G: usize, const R: usize, const N: usize>(
    lanes: L,
    dy: &[Block<T>],
    rows: usize,
    row: usize,
    w: &[Block<T>],
) -> [[L::V; N]; R] {
    let mut sums = [[lanes.splat(T::ZERO); N]; R];
    let groups = LANES / G;
    for (dy, w) in dy.chunks_exact(rows).zip(w.chunks_exact(groups * N)) {
        let dy: &[Block<T>; R] = head(&dy[row..]);
        for g in 0..groups {
            let w: &[Block<T>; N] = head(&w[g * N..]);
            let w = load_all(lanes, w);
            for r in 0..R {
                let d = lanes.group::<G>(&dy[r], g);
                for i in 0..N {
                    sums[r][i] = lanes.mul_add(d, w[i], sums[r][i]);
                }
            }
        }
    }
    sums
}

//! Matrix products for a line of output pixels of a first layer.

use symmetry::D2;

use crate::real::Real;
use crate::simd::gather::block_to_precision;
use crate::simd::interleave::first_n;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{FoldedLines, LANES_PER_GROUP, LineGradient};
use crate::simd::patches::{PatchGeometry, TapOrbit};
use crate::simd::tiles::load_blocks;
use crate::window::SlidingWindow;

/// Number of neighbouring output pixels that the forward pass of a first layer computes at once.
pub(crate) const LINE_TILE_PIXELS: usize = 8;
/// Number of image columns under the 4 x 4 windows of a tile with stride 2: neighbouring windows
/// share two of their four.
const COLUMNS: usize = 2 * LINE_TILE_PIXELS + 2;

/// Inner loops of a first layer's convolution for one line of output pixels.
#[derive(Clone, Copy)]
pub(crate) struct LineKernel<'a, T: Real, L: Lanes<T>> {
    lanes: L,
    patches: &'a PatchGeometry,
    channels: usize,
    /// Number of blocks of [`LANES`] values that an output pixel fills.
    blocks_per_pixel: usize,
    /// Distance between the windows of neighbouring output pixels, in values.
    step: usize,
    /// Sign of each lane's irrep under a flip of x.
    signs: L::V,
    /// `true` if windows are 4 x 4 with stride 2.
    is_4x4_stride_2: bool,
}

impl<'a, T: Real, L: Lanes<T>> LineKernel<'a, T, L> {
    #[inline(always)]
    pub fn new(lanes: L, patches: &'a PatchGeometry, width: usize) -> Self {
        let fields = patches.image_shape.fields;
        let irreps = fields.group().irreps();
        let mut signs = [T::ZERO; LANES];
        for (lane, sign) in signs.iter_mut().enumerate() {
            *sign = T::from_f64(irreps[lane % irreps.len()].sign(D2::FlipX).into());
        }
        let SlidingWindow { size, stride, .. } = patches.window;
        LineKernel {
            lanes,
            patches,
            channels: fields.dim(),
            is_4x4_stride_2: size == 4 && stride == 2,
            blocks_per_pixel: width,
            step: stride * fields.dim() * LANES_PER_GROUP,
            signs: lanes.load(&signs),
        }
    }

    /// Returns the start of the window of output pixel `ox` in the folded image rows, in values.
    pub fn window_start(&self, lines: &FoldedLines, ox: usize) -> usize {
        lines.alignment_shift() + ox * self.step
    }

    /// Writes the weighted sums `[pixel][block]` of the convolution for the first `rows` output
    /// pixels of a tile.
    #[inline(always)]
    pub fn write_weighted_sums(&self, x: &[T], w: &[Block<T>], sums: &mut [Block<T>], rows: usize) {
        // The last pixels of a line sum in the same order as the others: under a flip they are the
        // first.
        if L::REGISTERS >= 8 && self.is_4x4_stride_2 {
            self.tiles::<true>(x, w, sums, rows);
        } else {
            self.tiles::<false>(x, w, sums, rows);
        }
    }

    /// Writes the weighted sums of a tile of output pixels. `IS_4X4_STRIDE_2`: windows are 4 x 4
    /// with stride 2, so two windows read every column.
    #[inline(always)]
    fn tiles<const IS_4X4_STRIDE_2: bool>(
        &self,
        x: &[T],
        w: &[Block<T>],
        sums: &mut [Block<T>],
        rows: usize,
    ) {
        let mut first = 0;
        while first < self.blocks_per_pixel {
            first += match (L::REGISTERS, rows, self.blocks_per_pixel - first) {
                // three sets of R x V sums have to fit into the registers
                (32.., LINE_TILE_PIXELS, 2..) => {
                    self.pixels::<IS_4X4_STRIDE_2, 4, 2>(x, w, first, rows, sums)
                }
                (32.., LINE_TILE_PIXELS, _) => {
                    self.pixels::<IS_4X4_STRIDE_2, LINE_TILE_PIXELS, 1>(x, w, first, rows, sums)
                }
                (8..32, LINE_TILE_PIXELS, _) => {
                    self.pixels::<IS_4X4_STRIDE_2, 2, 1>(x, w, first, rows, sums)
                }
                _ => self.pixels::<IS_4X4_STRIDE_2, 1, 1>(x, w, first, rows, sums),
            };
        }
    }

    /// Writes V blocks of the weighted sums of `rows` output pixels, R pixels at a time, and
    /// returns V.
    #[inline(always)]
    fn pixels<const IS_4X4_STRIDE_2: bool, const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        rows: usize,
        sums: &mut [Block<T>],
    ) -> usize {
        for row in (0..rows).step_by(R) {
            if IS_4X4_STRIDE_2 {
                self.tile_of_shared_columns::<R, V>(x, w, first, row, sums);
            } else {
                self.tile::<R, V>(x, w, first, row, sums);
            }
        }
        V
    }

    /// Writes V blocks of the weighted sums of R output pixels.
    #[inline(always)]
    fn tile<const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        let lanes = self.lanes;
        let mut a = [[lanes.splat(T::ZERO); V]; R];
        let (mut b, mut middle) = (a, a);
        for orbit in &self.patches.orbits {
            let w = &w[orbit.first_block * (LANES / LANES_PER_GROUP) * self.blocks_per_pixel..]
                [..self.channels * self.blocks_per_pixel];
            let left = self.columns::<R>(x, row, orbit.tap_offsets[0]);
            match orbit.tap_offsets.get(1) {
                Some(&tap) => {
                    let right = self.columns::<R>(x, row, tap);
                    for c in 0..self.channels {
                        let w: [L::V; V] =
                            load_blocks(lanes, first_n(&w[c * self.blocks_per_pixel + first..]));
                        for r in 0..R {
                            let (left, right) = (
                                lanes.broadcast_quad(&left[r][c]),
                                lanes.broadcast_quad(&right[r][c]),
                            );
                            for v in 0..V {
                                a[r][v] = lanes.mul_add(left, w[v], a[r][v]);
                                b[r][v] = lanes.mul_add(right, w[v], b[r][v]);
                            }
                        }
                    }
                }
                None => {
                    for c in 0..self.channels {
                        let w: [L::V; V] =
                            load_blocks(lanes, first_n(&w[c * self.blocks_per_pixel + first..]));
                        for r in 0..R {
                            let input = lanes.broadcast_quad(&left[r][c]);
                            for v in 0..V {
                                middle[r][v] = lanes.mul_add(input, w[v], middle[r][v]);
                            }
                        }
                    }
                }
            }
        }
        self.combine([a, b], Some(middle), first, row, sums);
    }

    /// Writes V blocks of the weighted sums of R output pixels where two windows share every image
    /// column, which is loaded once for both.
    #[inline(always)]
    fn tile_of_shared_columns<const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        let lanes = self.lanes;
        let mut a = [[lanes.splat(T::ZERO); V]; R];
        let mut b = a;
        // a line has two orbits: the outer columns of a window and the inner ones
        for [outer, inner] in self.patches.orbits.as_chunks().0 {
            let of = |orbit: &TapOrbit| {
                &w[orbit.first_block * (LANES / LANES_PER_GROUP) * self.blocks_per_pixel + first..]
            };
            let (outer_w, inner_w) = (of(outer), of(inner));
            let x: &[[T; LANES_PER_GROUP]] =
                x[row * self.step + outer.tap_offsets[0]..].as_chunks().0;
            let mut columns: [&[[T; LANES_PER_GROUP]]; COLUMNS] = [&[]; COLUMNS];
            for (i, column) in columns[..2 * R + 2].iter_mut().enumerate() {
                *column = &x[i * self.channels..][..self.channels];
            }
            for c in 0..self.channels {
                let outer_weights: [L::V; V] =
                    load_blocks(lanes, first_n(&outer_w[c * self.blocks_per_pixel..]));
                let inner_weights: [L::V; V] =
                    load_blocks(lanes, first_n(&inner_w[c * self.blocks_per_pixel..]));
                let mut left =
                    [lanes.broadcast_quad(&columns[0][c]), lanes.broadcast_quad(&columns[1][c])];
                for r in 0..R {
                    let right = [
                        lanes.broadcast_quad(&columns[2 * r + 2][c]),
                        lanes.broadcast_quad(&columns[2 * r + 3][c]),
                    ];
                    for v in 0..V {
                        a[r][v] = lanes.mul_add(left[0], outer_weights[v], a[r][v]);
                        b[r][v] = lanes.mul_add(right[1], outer_weights[v], b[r][v]);
                        a[r][v] = lanes.mul_add(left[1], inner_weights[v], a[r][v]);
                        b[r][v] = lanes.mul_add(right[0], inner_weights[v], b[r][v]);
                    }
                    left = right;
                }
            }
        }
        self.combine([a, b], None, first, row, sums);
    }

    /// Writes the weighted sums of R output pixels, combined from those over both halves of the
    /// windows and over the middle column, if there is one.
    #[inline(always)]
    fn combine<const R: usize, const V: usize>(
        &self,
        [a, b]: [[[L::V; V]; R]; 2],
        middle: Option<[[L::V; V]; R]>,
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        for r in 0..R {
            for v in 0..V {
                let mut sum = self.lanes.mul_add(b[r][v], self.signs, a[r][v]);
                if let Some(middle) = middle {
                    sum = self.lanes.add(sum, middle[r][v]);
                }
                let to = &mut sums[(row + r) * self.blocks_per_pixel + first + v];
                self.lanes.store(to, sum);
            }
        }
    }

    /// Returns the folded channels that R neighbouring windows read at a tap.
    #[inline(always)]
    fn columns<'x, const R: usize>(
        &self,
        x: &'x [T],
        row: usize,
        tap: usize,
    ) -> [&'x [[T; LANES_PER_GROUP]]; R] {
        let mut columns: [&[[T; LANES_PER_GROUP]]; R] = [&[]; R];
        for (r, column) in columns.iter_mut().enumerate() {
            let at = (row + r) * self.step + tap;
            *column = &x[at..].as_chunks().0[..self.channels];
        }
        columns
    }

    /// Adds the weight gradient x^T dy of neighbouring output pixels for each column of the windows
    /// separately; dy is `[block][pixel]`, dw `[column][block]`.
    #[inline(always)]
    pub fn add_column_gradients(
        &self,
        lines: &FoldedLines,
        x: &[T],
        dy: &[Block<T>],
        dw: &mut [Block<T>],
    ) {
        let columns = lines.columns_per_window() / lines.lines_per_window();
        for i in 0..lines.lines_per_window() {
            let x = &x[lines.line_offset(i)..];
            let dw =
                &mut dw[i * columns * self.blocks_per_pixel..][..columns * self.blocks_per_pixel];
            let mut first = 0;
            while first < self.blocks_per_pixel {
                let tile = LineGradient {
                    lanes: self.lanes,
                    blocks_per_pixel: self.blocks_per_pixel,
                    step: self.step,
                    x,
                    dy,
                    first,
                };
                first += match (L::REGISTERS, self.blocks_per_pixel - first) {
                    (32.., 2..) => tile.add_column_gradient_blocks::<6, 2>(columns, dw),
                    (32.., _) => tile.add_column_gradient_blocks::<12, 1>(columns, dw),
                    (8..32, _) => tile.add_column_gradient_blocks::<6, 1>(columns, dw),
                    _ => tile.add_column_gradient_blocks::<4, 1>(columns, dw),
                };
            }
        }
    }

    /// Adds the column gradients of both halves of the windows to the gradient of the weights that
    /// the halves share.
    #[inline(always)]
    pub fn fold_column_gradients(
        &self,
        lines: &FoldedLines,
        columns: &[Block<T>],
        dw: &mut [Block<T>],
    ) {
        let lanes = self.lanes;
        let len = self.channels * self.blocks_per_pixel;
        for orbit in &self.patches.orbits {
            let dw = &mut dw
                [orbit.first_block * (LANES / LANES_PER_GROUP) * self.blocks_per_pixel..][..len];
            for (x, coefficients) in mirrored_columns(lines, orbit).zip(&orbit.coefficients) {
                let c = lanes.load(&block_to_precision(coefficients));
                for (d, part) in dw.iter_mut().zip(&columns[x * len..][..len]) {
                    lanes.store(d, lanes.mul_add(lanes.load(part), c, lanes.load(d)));
                }
            }
        }
    }
}

/// Returns the indices of the two window columns that belong to an orbit of taps, or of its only
/// one.
fn mirrored_columns(lines: &FoldedLines, orbit: &TapOrbit) -> impl Iterator<Item = usize> {
    let [y, x] = orbit.first_tap;
    let k = lines.kernel.size;
    [y * k + x, y * k + k - 1 - x].into_iter().take(orbit.tap_offsets.len())
}

//! Lines of first layers: images of trivial channels, as numbers or bytes, folded along y, and the
//! weight gradients of every column.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over constants that index several arrays of registers"
)]

use std::ops::Range;

use crate::real::Real;
use crate::shape::Shape;
use crate::simd::interleave::{first_n, first_n_mut};
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::window::SlidingWindow;

/// Number of lanes of a lane group of folded image rows: one for each irrep of D2.
pub(crate) const LANES_PER_GROUP: usize = 4;

/// Geometry of image rows that are folded along y: sums and differences of mirrored rows, for every
/// line of output pixels.
///
/// Rows t and k - 1 - t of the windows become e = a + b and o = a - b, and a channel becomes the
/// group e e o o. The fold along x later adds another such group or subtracts it. The middle row of
/// an odd kernel is its own e, and its o is zero.
#[derive(Clone, Debug)]
pub(crate) struct FoldedLines {
    image: Shape,
    /// Number of channels of the image, stored because every line needs it.
    channels: usize,
    pub kernel: SlidingWindow,
    /// Number of lines of output pixels.
    pub out_height: usize,
    /// Length of a folded line with its padding, in values.
    len: usize,
}

impl FoldedLines {
    pub fn new(image: Shape, kernel: SlidingWindow, out_height: usize, len: usize) -> FoldedLines {
        FoldedLines { image, channels: image.fields.dim(), kernel, out_height, len }
    }

    /// Returns the number of folded lines for one line of output pixels.
    pub fn lines_per_window(&self) -> usize {
        self.kernel.size.div_ceil(2)
    }

    /// Returns the number of columns of a window: its folded lines times taps along x times
    /// channels.
    pub fn columns_per_window(&self) -> usize {
        self.lines_per_window() * self.kernel.size * self.channels
    }

    /// Returns the length of the folded lines for one line of output pixels, in values of whole
    /// blocks.
    pub fn blocked_len(&self) -> usize {
        (self.alignment_shift() + self.line_offset(self.lines_per_window())).next_multiple_of(LANES)
    }

    /// Returns the start of folded line `i` relative to the first, in values.
    pub fn line_offset(&self, i: usize) -> usize {
        i * self.len
    }

    /// Returns the number of folded lines of an image.
    pub fn num_lines(&self) -> usize {
        self.out_height * self.lines_per_window()
    }

    /// Returns the start of the folded lines for output line `oy`, in values and without the shift
    /// of `alignment_shift`.
    pub fn first_line_start(&self, oy: usize) -> usize {
        self.line_offset(oy * self.lines_per_window())
    }

    /// Returns the length of a row of the image, in values.
    fn row_len(&self) -> usize {
        self.image.width * self.channels
    }

    /// Returns the start of the image row that output line `oy` reads at row `tap` of its windows;
    /// `None` if the row is padding.
    fn row(&self, oy: usize, tap: usize) -> Option<usize> {
        let row = (oy * self.kernel.stride + tap).checked_sub(self.kernel.padding)?;
        (row < self.image.height).then(|| row * self.row_len())
    }

    /// Returns the start of the part of folded line `i` of output line `oy` that is not padding.
    fn start(&self, oy: usize, i: usize) -> usize {
        let padding = 4 * self.kernel.padding * self.channels;
        self.alignment_shift() + self.first_line_start(oy) + self.line_offset(i) + padding
    }

    /// Returns the shift, in values, that aligns the first pixel of the folded lines with a cache
    /// line: a store that straddles two of them takes twice the time.
    pub fn alignment_shift(&self) -> usize {
        let padding = 4 * self.kernel.padding * self.channels;
        padding.next_multiple_of(LANES) - padding
    }

    /// Folds the rows of one image for a band of output lines: sums and differences of the rows of
    /// the taps t and k - 1 - t (see [`FoldedLines`]). Padding along x must be zero and stays so.
    #[inline(always)]
    pub fn fold_image<T: Real, L: Lanes<T>, P: Pixel<T>>(
        &self,
        lanes: L,
        image: &[P],
        band: Range<usize>,
        lines: &mut [T],
    ) {
        let len = self.row_len();
        for oy in band.clone() {
            for i in 0..self.lines_per_window() {
                let mirrored = self.kernel.size - 1 - i;
                let line = &mut lines[self.start(oy - band.start, i)..][..4 * len];
                let a = self.row(oy, i).map(|start| &image[start..][..len]);
                let start_of_b = self.row(oy, mirrored).filter(|_| mirrored != i);
                let b = start_of_b.map(|start| &image[start..][..len]);
                // a row of padding is zero, so e and o are the other row up to the sign of o
                match (a, b) {
                    (Some(a), Some(b)) => fold_rows(lanes, a, b, line),
                    (Some(a), None) => copy_row(a, mirrored != i, T::from_f64(1.0), line),
                    (None, Some(b)) => copy_row(b, true, T::from_f64(-1.0), line),
                    (None, None) => line.fill(T::ZERO),
                }
            }
        }
    }

    /// Applies the transpose of [`fold_image`](FoldedLines::fold_image), which takes gradients of
    /// the folded lines to the gradient of one image, and overwrites `image` with it.
    pub fn fold_image_backward<T: Real>(&self, lines: &[T], image: &mut [T]) {
        let len = self.row_len();
        image.fill(T::ZERO);
        for oy in 0..self.out_height {
            for i in 0..self.lines_per_window() {
                let mirrored = self.kernel.size - 1 - i;
                let line = lines[self.start(oy, i)..][..4 * len].as_chunks::<4>().0;
                // e = a + b and o = a - b: both gradients go to a, that of o negated to b
                if let Some(start) = self.row(oy, i) {
                    for (x, d) in image[start..][..len].iter_mut().zip(line) {
                        *x += d[0] + d[1];
                        if mirrored != i {
                            *x += d[2] + d[3];
                        }
                    }
                }
                if let Some(start) = self.row(oy, mirrored).filter(|_| mirrored != i) {
                    for (x, d) in image[start..][..len].iter_mut().zip(line) {
                        *x += d[0] + d[1] - d[2] - d[3];
                    }
                }
            }
        }
    }
}

/// Writes the sums e and differences o of two image rows as lane groups e e o o.
#[inline(always)]
fn fold_rows<T: Real, L: Lanes<T>, P: Pixel<T>>(lanes: L, a: &[P], b: &[P], line: &mut [T]) {
    let whole = a.len() / LANES * LANES;
    for at in (0..whole).step_by(LANES) {
        let (a, b) = (first_n(&a[at..]), first_n(&b[at..]));
        let (a, b) = (P::to_lanes(lanes, a), P::to_lanes(lanes, b));
        let (e, o) = (lanes.add(a, b), lanes.sub(a, b));
        for quarter in 0..4 {
            let block = first_n_mut(&mut line[4 * at + quarter * LANES..]);
            lanes.store(block, lanes.interleave_pair(e, o, quarter));
        }
    }
    let rest = line[4 * whole..].as_chunks_mut().0;
    for ((group, left), right) in rest.iter_mut().zip(&a[whole..]).zip(&b[whole..]) {
        let (left, right) = (left.to_number(), right.to_number());
        *group = [left + right, left + right, left - right, left - right];
    }
}

/// Folds an image row whose mirrored row is padding or does not exist.
#[inline(always)]
fn copy_row<T: Real, P: Pixel<T>>(row: &[P], odd: bool, sign: T, line: &mut [T]) {
    for (group, x) in line.as_chunks_mut().0.iter_mut().zip(row) {
        let x = x.to_number();
        let o = if odd { sign * x } else { T::ZERO };
        *group = [x, x, o, o];
    }
}

/// Factor by which a pixel's byte is scaled: 255 steps span one unit.
const BYTE_SCALE: f64 = 1.0 / 255.0;
/// Number subtracted from a pixel's scaled byte, which centres the range at zero.
const BYTE_OFFSET: f64 = 0.5;

/// Returns the number that a byte of an image stands for, byte / 255 - 0.5.
#[inline(always)]
pub fn pixel_byte_to_float<T: Real>(byte: u8) -> T {
    T::from_f64(f64::from(byte)) * T::from_f64(BYTE_SCALE) - T::from_f64(BYTE_OFFSET)
}

/// Value of one channel of an image pixel: a number, or a byte that stands for one.
pub(crate) trait Pixel<T>: Copy {
    /// Converts the value to its number.
    fn to_number(self) -> T;

    /// Converts sixteen values to their numbers.
    fn to_lanes<L: Lanes<T>>(lanes: L, pixels: &[Self; LANES]) -> L::V;
}

impl<T: Real> Pixel<T> for T {
    #[inline(always)]
    fn to_number(self) -> T {
        self
    }

    #[inline(always)]
    fn to_lanes<L: Lanes<T>>(lanes: L, pixels: &[T; LANES]) -> L::V {
        lanes.load(pixels)
    }
}

/// Conversion of bytes to their [`pixel_byte_to_float`]s, with the same rounding one by one and
/// sixteen at a time.
impl<T: Real> Pixel<T> for u8 {
    #[inline(always)]
    fn to_number(self) -> T {
        pixel_byte_to_float(self)
    }

    #[inline(always)]
    fn to_lanes<L: Lanes<T>>(lanes: L, pixels: &[u8; LANES]) -> L::V {
        let unit = lanes.mul(lanes.load_bytes(pixels), lanes.splat(T::from_f64(BYTE_SCALE)));
        lanes.sub(unit, lanes.splat(T::from_f64(BYTE_OFFSET)))
    }
}

/// Operands of the weight gradient of a line of output pixels.
pub(crate) struct LineGradient<'a, T, L> {
    pub lanes: L,
    /// Number of blocks of [`LANES`] values of an output pixel.
    pub blocks_per_pixel: usize,
    /// Distance between the windows of neighbouring output pixels, in values.
    pub step: usize,
    pub x: &'a [T],
    pub dy: &'a [Block<T>],
    /// Index of the first block of `dy` to process.
    pub first: usize,
}

impl<T: Real, L: Lanes<T>> LineGradient<'_, T, L> {
    /// Adds V blocks of the weight gradient of all window columns, K columns at a time, and returns
    /// V.
    #[inline(always)]
    pub fn add_column_gradient_blocks<const K: usize, const V: usize>(
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

    /// Adds V blocks of the weight gradient of K window columns.
    #[inline(always)]
    fn sum<const K: usize, const V: usize>(&self, column: usize, dw: &mut [Block<T>]) {
        let LineGradient { lanes, blocks_per_pixel: width, step, .. } = *self;
        let rows = self.dy.len() / width;
        let mut dy = [&self.dy[..rows]; V];
        for v in 0..V {
            dy[v] = &self.dy[(self.first + v) * rows..][..rows];
        }
        let mut sums = [[lanes.splat(T::ZERO); V]; K];
        for r in 0..rows {
            let x: &[[T; LANES_PER_GROUP]; K] =
                first_n(self.x[r * step + column * LANES_PER_GROUP..].as_chunks().0);
            for v in 0..V {
                let d = lanes.load(&dy[v][r]);
                for k in 0..K {
                    sums[k][v] = lanes.mul_add(lanes.broadcast_quad(&x[k]), d, sums[k][v]);
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

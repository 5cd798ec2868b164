//! Patches folded by parity: the gather of a steerable convolution.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};
use std::ops::Range;

use symmetry::{D2, FieldType, Group, Irrep};

use crate::butterfly::{
    Pixels, add_scaled, fold, fold_lines, pieces, scaled, unfold, unfold_lines,
};
use crate::taps::Taps;
use crate::{Kernel, Scalar};

/// The four matrices of a gather, one per output irrep, each `[rows, cols(b)]`.
pub(crate) type Matrices<'a, T> = [&'a mut [T]; 4];

/// The geometry of the fold.
///
/// The matrix of output irrep b is `[output pixels, cols(b)]`: the products of a patch with the functions of
/// [`Taps`]. Orbits of one or two taps are read from copies of the k rows that a line of output pixels
/// sees: taps t and g t become an even part (a + b) / sqrt2 and an odd part (a - b) / sqrt2,
/// and a tap that g leaves in place is even. D2 first folds the rows along y in the same way. The fold is
/// orthonormal: unfolding is its transpose.
#[derive(Clone, Debug)]
pub(crate) struct Fold {
    taps: Taps,
    kernel: Kernel,
    in_size: [usize; 2],
    out_size: [usize; 2],
    runs: Vec<Run>,
}

/// What happens to one run of channels of one folded line and one pair of its columns.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    /// The number of channels.
    pub len: usize,
    /// Where the left tap of the first output pixel starts in the lines.
    pub left: usize,
    /// Where the even part goes.
    pub even: Target,
    /// The right tap and where the odd part goes; a tap that is its own mirror image has neither.
    pub odd: Option<(usize, Target)>,
    /// The factor of a tap without a right one; pairs are bare sums.
    pub alone: f64,
}

/// A column of the matrix of an output irrep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    pub block: usize,
    pub column: usize,
    pub stride: usize,
}

impl Fold {
    pub fn new(
        in_type: FieldType,
        kernel: Kernel,
        in_size: [usize; 2],
        out_size: [usize; 2],
    ) -> Fold {
        let mut fold = Fold {
            taps: Taps::new(in_type, kernel.size),
            kernel,
            in_size,
            out_size,
            runs: Vec::new(),
        };
        fold.runs = fold.list_runs();
        fold
    }

    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    pub fn in_size(&self) -> [usize; 2] {
        self.in_size
    }

    pub fn out_size(&self) -> [usize; 2] {
        self.out_size
    }

    pub fn in_type(&self) -> FieldType {
        self.taps.in_type()
    }

    pub fn taps(&self) -> &Taps {
        &self.taps
    }

    fn group(&self) -> Group {
        self.in_type().group()
    }

    /// The number of columns of the matrix of output irrep b.
    pub fn cols(&self, b: Irrep) -> usize {
        self.taps.cols(b)
    }

    /// The length of the four matrices together, per output pixel.
    pub fn all_cols(&self) -> usize {
        Irrep::ALL.iter().map(|&b| self.cols(b)).sum()
    }

    pub fn out_pixels(&self) -> usize {
        self.out_size[0] * self.out_size[1]
    }

    fn row_len(&self) -> usize {
        self.in_size[1] * self.in_type().dim()
    }

    fn line_len(&self) -> usize {
        self.row_len() + 2 * self.kernel.padding * self.in_type().dim()
    }

    /// The length of the buffer of folded lines, with a row of zeros at its end.
    pub fn lines_len(&self) -> usize {
        self.kernel.size * self.line_len() + self.row_len()
    }

    fn list_runs(&self) -> Vec<Run> {
        let mut runs = Vec::new();
        for line in 0..self.kernel.size {
            for &irrep in self.group().irreps() {
                for channels in pieces(self.in_type().range(irrep)) {
                    let taps = 0..self.kernel.size;
                    runs.extend(taps.filter_map(|j| self.run([line, j], irrep, &channels)));
                }
            }
        }
        runs
    }

    /// The parity that a line already has, and the row of taps that it starts from.
    fn folded_line(&self, line: usize) -> (Irrep, usize) {
        let even = self.even_lines();
        match line.checked_sub(even) {
            Some(odd) => (Irrep::Y, odd),
            None => (Irrep::Trivial, line),
        }
    }

    /// The number of lines before the odd ones: D2 folds along y, the others leave the rows as they are.
    fn even_lines(&self) -> usize {
        match self.group() {
            Group::D2 => self.kernel.size.div_ceil(2),
            _ => self.kernel.size,
        }
    }

    /// What happens to a tap of a line, unless it is the right one of a pair.
    fn run(&self, [line, j]: [usize; 2], irrep: Irrep, channels: &Range<usize>) -> Option<Run> {
        let k = self.kernel.size;
        let (parity, row) = self.folded_line(line);
        let even = self.target(parity, [row, j], irrep, channels)?;
        // the flip that is left to the runs; C1 has none
        let mirror = self.group().elements().get(1).copied();
        let sign = self.group().irreps().get(1).copied();
        let odd = sign.and_then(|sign| self.target(parity * sign, [row, j], irrep, channels));
        let right = mirror.unwrap_or(D2::Identity).apply_pixel(line, j, k, k);
        let at = |line, tap| line * self.line_len() + tap * self.in_type().dim() + channels.start;
        Some(Run {
            len: channels.len(),
            left: at(line, j),
            even,
            odd: odd.map(|odd| (at(right.0, right.1), odd)),
            alone: if mirror.is_some() { SQRT_2 } else { 1.0 },
        })
    }

    /// Where the channels go for the function of this parity and first tap, if there is one.
    fn target(
        &self,
        parity: Irrep,
        tap: [usize; 2],
        irrep: Irrep,
        channels: &Range<usize>,
    ) -> Option<Target> {
        let function = self.taps.position(parity, tap)?;
        let b = self.group().restrict(irrep * parity);
        let first = channels.start - self.in_type().range(irrep).start;
        Some(Target {
            block: b.index(),
            column: self.taps.column(b, function) + first,
            stride: self.cols(b),
        })
    }

    fn pixels(&self, first: usize, oy: usize) -> Pixels {
        Pixels {
            first: first + oy * self.out_size[1],
            count: self.out_size[1],
            step: self.kernel.stride * self.in_type().dim(),
        }
    }

    /// Folds one image into rows `first..` of the matrices.
    pub fn gather<T: Scalar>(
        &self,
        image: &[T],
        lines: &mut [T],
        matrices: &mut Matrices<T>,
        first: usize,
    ) {
        lines.fill(T::ZERO);
        for oy in 0..self.out_size[0] {
            self.fold_rows(image, oy, lines);
            let pixels = self.pixels(first, oy);
            for run in &self.runs {
                fold(run, lines, matrices, pixels);
            }
        }
    }

    /// The transpose of [`gather`](Fold::gather): overwrites one image.
    pub fn scatter<T: Scalar>(
        &self,
        image: &mut [T],
        lines: &mut [T],
        matrices: &Matrices<T>,
        first: usize,
    ) {
        image.fill(T::ZERO);
        for oy in 0..self.out_size[0] {
            lines.fill(T::ZERO);
            let pixels = self.pixels(first, oy);
            for run in &self.runs {
                unfold(run, lines, matrices, pixels);
            }
            self.unfold_rows(image, oy, lines);
        }
    }

    /// Where the row of the image lies that a tap of an output row sees, unless it is padding.
    fn row(&self, oy: usize, tap: usize) -> Option<Range<usize>> {
        let row = (oy * self.kernel.stride + tap).checked_sub(self.kernel.padding)?;
        let len = self.row_len();
        (row < self.in_size[0]).then(|| row * len..(row + 1) * len)
    }

    /// The part of folded line `i` that is not padding.
    fn line(&self, i: usize) -> Range<usize> {
        let start = i * self.line_len() + self.kernel.padding * self.in_type().dim();
        start..start + self.row_len()
    }

    fn fold_rows<T: Scalar>(&self, image: &[T], oy: usize, lines: &mut [T]) {
        let k = self.kernel.size;
        let (lines, zeros) = lines.split_at_mut(k * self.line_len());
        let row = |tap| match self.row(oy, tap) {
            Some(range) => &image[range],
            None => &*zeros,
        };
        let (even, odd) = lines.split_at_mut(self.even_lines() * self.line_len());
        for i in 0..k - self.even_lines() {
            let (even, odd) = (&mut even[self.line(i)], &mut odd[self.line(i)]);
            fold_lines(row(i), row(k - 1 - i), even, odd);
        }
        for i in k - self.even_lines()..self.even_lines() {
            scaled(row(i), self.row_scale(), &mut even[self.line(i)]);
        }
    }

    fn unfold_rows<T: Scalar>(&self, image: &mut [T], oy: usize, lines: &[T]) {
        let k = self.kernel.size;
        let (even, odd) = lines.split_at(self.even_lines() * self.line_len());
        for i in 0..k - self.even_lines() {
            let (even, odd) = (&even[self.line(i)], &odd[self.line(i)]);
            if let Some(top) = self.row(oy, i) {
                unfold_lines(even, odd, T::from_f64(1.0), &mut image[top]);
            }
            if let Some(bottom) = self.row(oy, k - 1 - i) {
                unfold_lines(even, odd, T::from_f64(-1.0), &mut image[bottom]);
            }
        }
        for i in k - self.even_lines()..self.even_lines() {
            if let Some(row) = self.row(oy, i) {
                add_scaled(&even[self.line(i)], self.row_scale(), &mut image[row]);
            }
        }
    }

    /// The factor of a row that is not folded with another.
    fn row_scale<T: Scalar>(&self) -> T {
        T::from_f64(match self.group() {
            Group::C1 => 1.0,
            _ => FRAC_1_SQRT_2,
        })
    }
}

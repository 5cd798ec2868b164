//! Patches folded into even and odd parts along both axes: the gather of a steerable convolution.

use std::ops::Range;

use symmetry::{FieldType, Irrep};

use crate::butterfly::{
    Pixels, fold, fold_lines, fold_middle, pieces, unfold, unfold_lines, unfold_middle,
};
use crate::{Kernel, Scalar};

/// The four matrices of a gather, one per output irrep, each `[rows, cols(b)]`.
pub(crate) type Matrices<'a, T> = [&'a mut [T]; 4];

/// The geometry of the fold.
///
/// Taps t and k - 1 - t of an axis become an even part (a + b) / sqrt2 and an odd part
/// (a - b) / sqrt2; the middle tap of an odd k is even. A folded tap of parity p = (odd in
/// x) + 2 (odd in y) has the sign of irrep p, so it takes input irrep a to output irrep a xor p. The
/// matrix of output irrep b is `[output pixels, cols(b)]`, its columns ordered by parity, folded tap and
/// channel. The fold is orthonormal: unfolding is its transpose.
#[derive(Clone, Debug)]
pub(crate) struct Fold {
    in_type: FieldType,
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
    /// The right tap and where the odd part goes; the middle tap has neither.
    pub odd: Option<(usize, Target)>,
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
            in_type,
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
        self.in_type
    }

    /// The number of folded taps of an axis that are even (0) or odd (1).
    pub fn axis_taps(&self, odd: usize) -> usize {
        (self.kernel.size + 1 - odd) / 2
    }

    /// The first column, in the matrix of output irrep b, of a folded tap's channels.
    ///
    /// `y` and `x` are (parity, index) along the axes.
    pub fn column(&self, b: Irrep, y: (usize, usize), x: (usize, usize)) -> usize {
        let parity = Irrep::ALL[x.0 + 2 * y.0];
        let before = &Irrep::ALL[..parity.index()];
        let before: usize = before.iter().map(|&p| self.cols_of(b, p)).sum();
        let tap = y.1 * self.axis_taps(x.0) + x.1;
        before + tap * self.in_type.multiplicity(b * parity)
    }

    fn cols_of(&self, b: Irrep, parity: Irrep) -> usize {
        let taps = self.axis_taps(parity.index() & 1) * self.axis_taps(parity.index() >> 1);
        taps * self.in_type.multiplicity(b * parity)
    }

    /// The number of columns of the matrix of output irrep b.
    pub fn cols(&self, b: Irrep) -> usize {
        Irrep::ALL.iter().map(|&p| self.cols_of(b, p)).sum()
    }

    /// The length of the four matrices together, per output pixel.
    pub fn all_cols(&self) -> usize {
        Irrep::ALL.iter().map(|&b| self.cols(b)).sum()
    }

    pub fn out_pixels(&self) -> usize {
        self.out_size[0] * self.out_size[1]
    }

    fn row_len(&self) -> usize {
        self.in_size[1] * self.in_type.dim()
    }

    fn line_len(&self) -> usize {
        self.row_len() + 2 * self.kernel.padding * self.in_type.dim()
    }

    /// The length of the buffer of folded lines, with a row of zeros at its end.
    pub fn lines_len(&self) -> usize {
        self.kernel.size * self.line_len() + self.row_len()
    }

    fn list_runs(&self) -> Vec<Run> {
        let mut runs = Vec::new();
        for y_odd in [0, 1] {
            for i in 0..self.axis_taps(y_odd) {
                for irrep in Irrep::ALL {
                    for channels in pieces(self.in_type.range(irrep)) {
                        let taps = 0..self.axis_taps(0);
                        runs.extend(taps.map(|j| self.run((y_odd, i), j, irrep, &channels)));
                    }
                }
            }
        }
        runs
    }

    fn run(&self, y: (usize, usize), j: usize, irrep: Irrep, channels: &Range<usize>) -> Run {
        let line = (y.0 * self.axis_taps(0) + y.1) * self.line_len();
        let at = |tap: usize| line + tap * self.in_type.dim() + channels.start;
        let target = |x_odd| {
            let mut target = self.target(y, (x_odd, j), irrep);
            target.column += channels.start - self.in_type.range(irrep).start;
            target
        };
        let mirrored = self.kernel.size - 1 - j;
        Run {
            len: channels.len(),
            left: at(j),
            even: target(0),
            odd: (mirrored != j).then(|| (at(mirrored), target(1))),
        }
    }

    fn target(&self, y: (usize, usize), x: (usize, usize), irrep: Irrep) -> Target {
        let b = irrep * Irrep::ALL[x.0 + 2 * y.0];
        Target {
            block: b.index(),
            column: self.column(b, y, x),
            stride: self.cols(b),
        }
    }

    fn pixels(&self, first: usize, oy: usize) -> Pixels {
        Pixels {
            first: first + oy * self.out_size[1],
            count: self.out_size[1],
            step: self.kernel.stride * self.in_type.dim(),
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
        let start = i * self.line_len() + self.kernel.padding * self.in_type.dim();
        start..start + self.row_len()
    }

    fn fold_rows<T: Scalar>(&self, image: &[T], oy: usize, lines: &mut [T]) {
        let k = self.kernel.size;
        let (lines, zeros) = lines.split_at_mut(k * self.line_len());
        let row = |tap| match self.row(oy, tap) {
            Some(range) => &image[range],
            None => &*zeros,
        };
        let (even, odd) = lines.split_at_mut(self.axis_taps(0) * self.line_len());
        for i in 0..k / 2 {
            let (even, odd) = (&mut even[self.line(i)], &mut odd[self.line(i)]);
            fold_lines(row(i), row(k - 1 - i), even, odd);
        }
        if k % 2 == 1 {
            fold_middle(row(k / 2), &mut even[self.line(k / 2)]);
        }
    }

    fn unfold_rows<T: Scalar>(&self, image: &mut [T], oy: usize, lines: &[T]) {
        let k = self.kernel.size;
        let (even, odd) = lines.split_at(self.axis_taps(0) * self.line_len());
        for i in 0..k / 2 {
            let (even, odd) = (&even[self.line(i)], &odd[self.line(i)]);
            if let Some(top) = self.row(oy, i) {
                unfold_lines(even, odd, T::from_f64(1.0), &mut image[top]);
            }
            if let Some(bottom) = self.row(oy, k - 1 - i) {
                unfold_lines(even, odd, T::from_f64(-1.0), &mut image[bottom]);
            }
        }
        if k % 2 == 1
            && let Some(middle) = self.row(oy, k / 2)
        {
            unfold_middle(&even[self.line(k / 2)], &mut image[middle]);
        }
    }
}

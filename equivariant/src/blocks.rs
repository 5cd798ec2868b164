//! The block-diagonal linear map: one weight matrix per output irrep.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand::Rng;
use symmetry::{FieldType, Irrep};

use crate::Scalar;
use crate::init::fill_normal;

/// A row-major view of some columns of a wider matrix: row `r` starts at `r * stride`.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a, T> {
    pub data: &'a [T],
    pub stride: usize,
}

/// The same, to be written.
pub(crate) struct RowsMut<'a, T> {
    pub data: &'a mut [T],
    pub stride: usize,
}

/// Parameter layout and products of an equivariant linear map.
///
/// Output irrep b sees `cols[b]` inputs; irreps that the group lacks see and have none. Its weights are `[out multiplicity of b, cols[b]]`,
/// row-major, the blocks in irrep order, then one bias per trivial output channel.
#[derive(Clone, Debug)]
pub(crate) struct Blocks {
    cols: [usize; 4],
    out: FieldType,
}

impl Blocks {
    pub fn new(cols: [usize; 4], out: FieldType) -> Blocks {
        Blocks { cols, out }
    }

    pub fn cols(&self, b: Irrep) -> usize {
        self.cols[b.index()]
    }

    fn block_len(&self, b: Irrep) -> usize {
        self.cols(b) * self.out.multiplicity(b)
    }

    /// Where the weights of a block lie among the parameters.
    pub fn weights(&self, b: Irrep) -> Range<usize> {
        let start = Irrep::ALL[..b.index()]
            .iter()
            .map(|&a| self.block_len(a))
            .sum();
        start..start + self.block_len(b)
    }

    pub fn bias(&self) -> Range<usize> {
        let start = self.weights(Irrep::XY).end;
        start..start + self.out.multiplicity(Irrep::Trivial)
    }

    pub fn num_params(&self) -> usize {
        self.bias().end
    }

    pub fn init<T: Scalar>(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        assert_eq!(
            params.len(),
            self.num_params(),
            "wrong number of parameters"
        );
        for b in Irrep::ALL {
            let std = gain / (self.cols(b).max(1) as f64).sqrt();
            fill_normal(rng, std, &mut params[self.weights(b)]);
        }
        params[self.bias()].fill(T::ZERO);
    }

    /// Writes the bias into the trivial channels of every row of `y` and zero into the others.
    pub fn fill_bias<T: Scalar>(&self, params: &[T], y: &mut [T]) {
        let bias = &params[self.bias()];
        for row in y.chunks_exact_mut(self.out.dim().max(1)) {
            let (trivial, rest) = row.split_at_mut(bias.len());
            trivial.copy_from_slice(bias);
            rest.fill(T::ZERO);
        }
    }

    /// Adds the sum of the trivial channels of `dy` to the gradient of the bias.
    pub fn add_bias_gradient<T: Scalar>(&self, dy: &[T], dparams: &mut [T]) {
        let dbias = &mut dparams[self.bias()];
        for row in dy.chunks_exact(self.out.dim().max(1)) {
            for (sum, &d) in dbias.iter_mut().zip(row) {
                *sum += d;
            }
        }
    }

    /// y_b += x W_b^T, with y `[rows, dim]` and x `[rows, cols[b]]`.
    pub fn forward<T: Scalar>(&self, b: Irrep, params: &[T], x: Rows<T>, y: &mut [T]) {
        let (k, n) = (self.cols(b), self.out.multiplicity(b));
        let rows = y.len() / self.out.dim().max(1);
        if k * n * rows == 0 {
            return;
        }
        let y = RowsMut {
            data: &mut y[self.out.range(b).start..],
            stride: self.out.dim(),
        };
        let y = y.view(rows, n);
        let weight = MatRef::from_row_major_slice(&params[self.weights(b)], n, k);
        matmul(
            y,
            Accum::Add,
            x.view(rows, k),
            weight.transpose(),
            T::from_f64(1.0),
            Par::Seq,
        );
    }

    /// dW_b += dy_b^T x.
    pub fn add_weight_gradient<T: Scalar>(
        &self,
        b: Irrep,
        x: Rows<T>,
        dy: &[T],
        dparams: &mut [T],
    ) {
        let (k, n) = (self.cols(b), self.out.multiplicity(b));
        let rows = dy.len() / self.out.dim().max(1);
        if k * n * rows == 0 {
            return;
        }
        let dweight = MatMut::from_row_major_slice_mut(&mut dparams[self.weights(b)], n, k);
        matmul(
            dweight,
            Accum::Add,
            self.output(b, dy).view(rows, n).transpose(),
            x.view(rows, k),
            T::from_f64(1.0),
            Par::Seq,
        );
    }

    /// dx = dy_b W_b; zero where the block has no outputs.
    pub fn input_gradient<T: Scalar>(&self, b: Irrep, params: &[T], dy: &[T], dx: RowsMut<T>) {
        let (k, n) = (self.cols(b), self.out.multiplicity(b));
        let rows = dy.len() / self.out.dim().max(1);
        if k * rows == 0 {
            return;
        }
        if n == 0 {
            for row in dx.data.chunks_mut(dx.stride).take(rows) {
                row[..k].fill(T::ZERO);
            }
            return;
        }
        let dx = dx.view(rows, k);
        let weight = MatRef::from_row_major_slice(&params[self.weights(b)], n, k);
        matmul(
            dx,
            Accum::Replace,
            self.output(b, dy).view(rows, n),
            weight,
            T::from_f64(1.0),
            Par::Seq,
        );
    }

    fn output<'a, T>(&self, b: Irrep, dy: &'a [T]) -> Rows<'a, T> {
        Rows {
            data: &dy[self.out.range(b).start..],
            stride: self.out.dim(),
        }
    }
}

impl<'a, T> Rows<'a, T> {
    fn view(self, rows: usize, cols: usize) -> MatRef<'a, T> {
        MatRef::from_row_major_slice_with_stride(self.data, rows, cols, self.stride)
    }
}

impl<'a, T> RowsMut<'a, T> {
    fn view(self, rows: usize, cols: usize) -> MatMut<'a, T> {
        // the transpose of a column-major view, because faer 0.24.4 confuses the strides in
        // `from_row_major_slice_with_stride_mut` and then writes outside the slice
        MatMut::from_column_major_slice_with_stride_mut(self.data, cols, rows, self.stride)
            .transpose_mut()
    }
}

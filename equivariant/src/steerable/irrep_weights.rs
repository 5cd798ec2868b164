//! Block-diagonal linear map: one weight matrix per output irrep.

use std::ops::Range;

use faer::MatRef;
use rand::Rng;
use symmetry::{FieldType, Irrep};

use crate::matrix::{MatrixProductOperands, row_major, row_major_mut};
use crate::real::{Real, fill_normal};

/// Parameter layout and matrix products of an equivariant linear map with one weight matrix per
/// irrep.
///
/// Output irrep b has `cols[b]` inputs; irreps that the group lacks have no inputs and no outputs.
/// The weights of b are `[out multiplicity of b, cols[b]]`, row-major. The blocks come in irrep
/// order, then one bias per trivial output channel.
#[derive(Clone, Debug)]
pub(crate) struct IrrepWeights {
    cols: [usize; 4],
    out: FieldType,
}

impl IrrepWeights {
    pub fn new(cols: [usize; 4], out: FieldType) -> IrrepWeights {
        IrrepWeights { cols, out }
    }

    /// Returns the number of inputs of output irrep b, the columns of its weight matrix.
    pub fn num_inputs(&self, b: Irrep) -> usize {
        self.cols[b.index()]
    }

    fn block_len(&self, b: Irrep) -> usize {
        self.num_inputs(b) * self.out.multiplicity(b)
    }

    /// Returns the range of the weights of output irrep b among the parameters.
    pub fn weight_range(&self, b: Irrep) -> Range<usize> {
        let start = Irrep::ALL[..b.index()].iter().map(|&a| self.block_len(a)).sum();
        start..start + self.block_len(b)
    }

    /// Returns the range of the biases among the parameters.
    pub fn bias_range(&self) -> Range<usize> {
        let start = self.weight_range(Irrep::XY).end;
        start..start + self.out.multiplicity(Irrep::Trivial)
    }

    pub fn num_params(&self) -> usize {
        self.bias_range().end
    }

    /// Samples the initial weights with variance gain^2 / fan-in and sets the biases to zero.
    pub fn init<T: Real>(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        assert_eq!(params.len(), self.num_params(), "wrong number of parameters");
        for b in Irrep::ALL {
            let std = gain / (self.num_inputs(b).max(1) as f64).sqrt();
            fill_normal(rng, std, &mut params[self.weight_range(b)]);
        }
        params[self.bias_range()].fill(T::ZERO);
    }

    /// Writes the bias into the trivial channels of every output vector in `y` and zero into the
    /// other channels.
    pub fn fill_bias<T: Real>(&self, params: &[T], y: &mut [T]) {
        let bias = &params[self.bias_range()];
        for row in y.chunks_exact_mut(self.out.dim().max(1)) {
            let (trivial, rest) = row.split_at_mut(bias.len());
            trivial.copy_from_slice(bias);
            rest.fill(T::ZERO);
        }
    }

    /// Adds each trivial channel of `dy`, summed over the output vectors, to the gradient of its
    /// bias.
    pub fn add_bias_gradient<T: Real>(&self, dy: &[T], dparams: &mut [T]) {
        let dbias = &mut dparams[self.bias_range()];
        for row in dy.chunks_exact(self.out.dim().max(1)) {
            for (sum, &d) in dbias.iter_mut().zip(row) {
                *sum += d;
            }
        }
    }

    /// Adds x_b W_b^T to the channels of irrep b of the output `y` `[rows, dim]`, for the inputs
    /// `x` `[rows, channels]` of output irrep b.
    pub fn add_product<T: Real>(&self, b: Irrep, params: &[T], x: IrrepChannels<T>, y: &mut [T]) {
        let Some([rows, k, n]) = self.sizes(b, y.len()) else {
            return;
        };
        let y = &mut y[self.out.channel_range(b).start..];
        T::multiply_matrices(MatrixProductOperands {
            to: row_major_mut(y, [rows, n], self.out.dim()),
            add: true,
            a: x.view([rows, k]),
            b: row_major(&params[self.weight_range(b)], [n, k], k).transpose(),
        });
    }

    /// Adds dy_b^T x_b to the gradient with respect to the weights W_b of output irrep b.
    pub fn add_weight_gradient<T: Real>(
        &self,
        b: Irrep,
        x: IrrepChannels<T>,
        dy: &[T],
        dparams: &mut [T],
    ) {
        let Some([rows, k, n]) = self.sizes(b, dy.len()) else {
            return;
        };
        T::multiply_matrices(MatrixProductOperands {
            to: row_major_mut(&mut dparams[self.weight_range(b)], [n, k], k),
            add: true,
            a: IrrepChannels::new(self.out, b, dy).view([rows, n]).transpose(),
            b: x.view([rows, k]),
        });
    }

    /// Writes the input gradient dx_b = dy_b W_b of irrep b; zero if the output lacks the irrep.
    /// `dx` starts with the first channel of the irrep and has `stride` channels.
    pub fn write_input_gradient<T: Real>(
        &self,
        b: Irrep,
        params: &[T],
        dy: &[T],
        dx: &mut [T],
        stride: usize,
    ) {
        if let Some([rows, k, n]) = self.sizes(b, dy.len()) {
            T::multiply_matrices(MatrixProductOperands {
                to: row_major_mut(dx, [rows, k], stride),
                add: false,
                a: IrrepChannels::new(self.out, b, dy).view([rows, n]),
                b: row_major(&params[self.weight_range(b)], [n, k], k),
            });
        } else if self.out.multiplicity(b) == 0 {
            // inputs that no output uses have a gradient of zero
            for row in dx.chunks_mut(stride) {
                row[..self.num_inputs(b)].fill(T::ZERO);
            }
        }
    }

    /// Returns the numbers of rows, inputs and outputs of the matrix product of irrep b for an
    /// output of `out_len` values; `None` if one of them is 0.
    fn sizes(&self, b: Irrep, out_len: usize) -> Option<[usize; 3]> {
        let rows = out_len / self.out.dim();
        let sizes = [rows, self.num_inputs(b), self.out.multiplicity(b)];
        (!sizes.contains(&0)).then_some(sizes)
    }
}

/// Channels of one irrep in vectors of `stride` channels; the slice starts at the irrep's first
/// channel.
#[derive(Clone, Copy)]
pub(crate) struct IrrepChannels<'a, T> {
    data: &'a [T],
    stride: usize,
}

impl<'a, T> IrrepChannels<'a, T> {
    /// Returns the channels of irrep b in vectors of the field type `fields`.
    pub fn new(fields: FieldType, b: Irrep, vectors: &'a [T]) -> Self {
        IrrepChannels {
            // a slice of no samples is shorter than the start of an irrep
            data: vectors.get(fields.channel_range(b).start..).unwrap_or_default(),
            stride: fields.dim(),
        }
    }

    fn view(self, size: [usize; 2]) -> MatRef<'a, T> {
        row_major(self.data, size, self.stride)
    }
}

//! What a gated recurrent unit keeps between its passes.

use std::ops::Range;

use crate::layers::scalar::Scalar;
use crate::scratch::Scratch;

/// What the forward pass of a [`Gru`](crate::Gru) leaves for the backward pass, over up to a fixed
/// number of sequences.
#[derive(Clone, Debug)]
pub struct GruPass<T> {
    /// Channels of the input and of the state.
    pub(super) dims: [usize; 2],
    /// For how many steps and samples there is room.
    pub(super) room: [usize; 2],
    /// Those of the last forward pass.
    pub(super) sizes: [usize; 2],
    /// Whether it holds what a forward pass left and no backward pass has written over.
    pub(super) holds_values: bool,
    /// Steps that each sample begins after, `[N]`.
    pub(super) begins: Vec<usize>,
    /// The row of the input that each step reads, `[L, N]`; none before a sequence begins.
    pub(super) reads: Vec<Option<usize>>,
    /// The part in the gates of each row of the input, then the gradient in it, `[M, 3 H]`.
    pub(super) row_gates: Vec<T>,
    /// States `[L + 1, N, H]` in the regular basis, and in that of the irreps.
    pub(super) states: Vec<T>,
    pub(super) coefficients: Vec<T>,
    /// The input's part of the gates, then r, z and n, `[L, N, 3 H]`.
    pub(super) gates: Vec<T>,
    /// The state's part of the gates, then the gradient in it, `[N, 3 H]`.
    pub(super) from_state: Vec<T>,
    /// W_hn h + b_hn, `[L, N, H]`.
    pub(super) candidates: Vec<T>,
    /// Gradients in the state, and in the state before, `[N, H]`.
    pub(super) d_state: Vec<T>,
    pub(super) d_before: Vec<T>,
    pub(super) scratch: Scratch<T>,
}

impl<T: Scalar> GruPass<T> {
    /// Room for steps and samples of a unit with `dims` channels of input and state, and with the
    /// scratch of its matrix for the input.
    pub(super) fn new(dims: [usize; 2], room: [usize; 2], scratch: Scratch<T>) -> Self {
        let zeros = |len: usize| vec![T::ZERO; len];
        let ([steps, samples], state) = (room, room[1] * dims[1]);
        Self {
            dims,
            room,
            sizes: [0; 2],
            holds_values: false,
            begins: Vec::with_capacity(samples),
            reads: Vec::with_capacity(steps * samples),
            row_gates: zeros(steps * 3 * state),
            states: zeros((steps + 1) * state),
            coefficients: zeros((steps + 1) * state),
            gates: zeros(steps * 3 * state),
            from_state: zeros(3 * state),
            candidates: zeros(steps * state),
            d_state: zeros(state),
            d_before: zeros(state),
            scratch,
        }
    }

    /// The states `[N, H]` after the last step of the last forward pass.
    pub fn out(&self) -> &[T] {
        &self.coefficients[self.rows(self.sizes[0])]
    }

    /// Where the states before a step are.
    pub(super) fn rows(&self, step: usize) -> Range<usize> {
        let len = self.sizes[1] * self.dims[1];
        step * len..(step + 1) * len
    }

    /// Copies the part of each row to the gates, `width` of them, of the steps that read it.
    pub(super) fn spread_rows(&mut self, width: usize) {
        for (to, read) in self.gates.chunks_exact_mut(width).zip(&self.reads) {
            if let Some(row) = read {
                to.copy_from_slice(&self.row_gates[row * width..(row + 1) * width]);
            }
        }
    }

    /// Adds up the gradients in the gates of all steps that read the same row.
    pub(super) fn gather_rows(&mut self, width: usize) {
        self.row_gates.fill(T::ZERO);
        for (from, read) in self.gates.chunks_exact(width).zip(&self.reads) {
            if let Some(row) = read {
                let sums = &mut self.row_gates[row * width..(row + 1) * width];
                sums.iter_mut().zip(from).for_each(|(sum, &d)| *sum += d);
            }
        }
    }
}

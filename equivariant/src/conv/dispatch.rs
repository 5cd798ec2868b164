//! Choice of kernel, instruction set and number of threads for the passes of a convolution.

use crate::chunks::runs_one_of_many_chunks;
use crate::conv::operands::{ConvBackwardOperands, ConvForwardOperands};
use crate::conv::pool::{MaxPoolBackwardOperands, MaxPoolForwardOperands};
use crate::conv::r2_conv::R2Conv;
use crate::conv::{backward, forward};
use crate::real::Real;
use crate::simd::lanes::{LANES, Lanes, Portable, WithLanes, run_f32};
use crate::steerable::hadamard::with_const_order;

/// Number of multiplications in the convolution of one image from which a second thread pays,
/// although waking it takes microseconds.
const MIN_PRODUCTS_TO_SPLIT: usize = 1 << 18;

/// Floating-point type for which the passes of convolutions and poolings are compiled. The trait is
/// implemented for two types rather than generically, so that passes are compiled once and with
/// this crate's settings.
pub trait ConvScalar: Real {
    /// Runs the forward pass of a convolution in this precision.
    fn forward(pass: ConvForwardOperands<Self>);

    /// Runs the backward pass of a convolution in this precision.
    fn backward(pass: ConvBackwardOperands<Self>);

    /// Runs the forward pass of a max-pooling in this precision.
    fn max_pool_forward(pass: MaxPoolForwardOperands<Self>);

    /// Runs the backward pass of a max-pooling in this precision.
    fn max_pool_backward(pass: MaxPoolBackwardOperands<Self>);
}

impl ConvScalar for f32 {
    fn forward(pass: ConvForwardOperands<f32>) {
        let widest = pass.conv.widest_instruction_set;
        run_f32(pass, widest);
    }

    fn backward(pass: ConvBackwardOperands<f32>) {
        let widest = pass.conv.widest_instruction_set;
        run_f32(pass, widest);
    }

    fn max_pool_forward(pass: MaxPoolForwardOperands<f32>) {
        let widest = pass.pool.widest_instruction_set;
        run_f32(pass, widest);
    }

    fn max_pool_backward(pass: MaxPoolBackwardOperands<f32>) {
        let widest = pass.pool.widest_instruction_set;
        run_f32(pass, widest);
    }
}

impl ConvScalar for f64 {
    fn forward(pass: ConvForwardOperands<f64>) {
        pass.run(Portable);
    }

    fn backward(pass: ConvBackwardOperands<f64>) {
        pass.run(Portable);
    }

    fn max_pool_forward(pass: MaxPoolForwardOperands<f64>) {
        pass.run(Portable);
    }

    fn max_pool_backward(pass: MaxPoolBackwardOperands<f64>) {
        pass.run(Portable);
    }
}

/// Returns the length, in values, of scratch memory that is large enough for either pass of a
/// convolution; `is_blocked` is `true` if the input is in the blocked layout already.
pub(crate) fn scratch_len(conv: &R2Conv, samples: usize, is_blocked: bool) -> usize {
    let forward = forward::scratch_len(conv, samples, is_blocked);
    forward.max(backward::scratch_len(conv, samples, is_blocked))
}

impl<T: ConvScalar> ConvForwardOperands<'_, T> {
    /// Runs the forward pass of a convolution, in two halves for a large single image if the
    /// current rayon pool may have a free thread. The bits are the same either way.
    pub(crate) fn run_on_threads(self) {
        let products =
            self.conv.out_shape.num_pixels() * self.conv.weights.num_packed_blocks() * LANES;
        let worth = self.samples == 1
            && self.conv.out_shape.height > 1
            && products >= MIN_PRODUCTS_TO_SPLIT;
        // outside a pool rayon::join would move work to the global pool, which the caller did not
        // choose
        let threads = match rayon::current_thread_index() {
            Some(_) if !runs_one_of_many_chunks() => rayon::current_num_threads(),
            _ => 1,
        };
        if worth && threads > 1 {
            let (above, below) = self.split_in_half();
            rayon::join(|| T::forward(above), || T::forward(below));
        } else {
            T::forward(self);
        }
    }
}

impl<T: Real> WithLanes<T> for ConvForwardOperands<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        if let Some(lines) = &self.conv.patches.folded_lines {
            return self.run_lines(lanes, lines);
        }
        with_const_order!(G = self.conv.weights.group_order, self.run_panels::<L, G>(lanes));
    }
}

impl<T: Real> WithLanes<T> for ConvBackwardOperands<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        // lines give gradients of parameters only; a gradient with respect to the input needs
        // panels
        if let (Some(lines), None) = (&self.conv.patches.folded_lines, &self.dx) {
            return self.run_lines(lanes, lines);
        }
        with_const_order!(G = self.conv.weights.group_order, self.run_panels::<L, G>(lanes));
    }
}

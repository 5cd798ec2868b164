//! The passes of a convolution: which kernel runs, on which instruction set and on how many
//! threads.

use crate::chunks::in_one_of_many_chunks;
use crate::conv::operands::{Backward, Forward};
use crate::conv::pool::{Pooling, Unpooling};
use crate::conv::r2_conv::R2Conv;
use crate::conv::{backward, forward};
use crate::real::Real;
use crate::simd::lanes::{LANES, Lanes, Portable, WithLanes, run_f32};
use crate::steerable::hadamard::with_order;

/// Multiplications from which on half of them are worth another thread, which takes microseconds to
/// get.
const SPLIT: usize = 1 << 18;

/// The precisions that passes are compiled for: not generic, so that they are compiled once and
/// with this crate's settings.
pub trait Passes: Real {
    /// Runs a forward pass.
    fn forward(pass: Forward<Self>);

    /// Runs a backward pass.
    fn backward(pass: Backward<Self>);

    /// Runs a pooling.
    fn pool(pass: Pooling<Self>);

    /// Runs the backward pass of a pooling.
    fn unpool(pass: Unpooling<Self>);
}

impl Passes for f32 {
    fn forward(pass: Forward<f32>) {
        let widest = pass.conv.widest;
        run_f32(pass, widest);
    }

    fn backward(pass: Backward<f32>) {
        let widest = pass.conv.widest;
        run_f32(pass, widest);
    }

    fn pool(pass: Pooling<f32>) {
        let widest = pass.pool.widest;
        run_f32(pass, widest);
    }

    fn unpool(pass: Unpooling<f32>) {
        let widest = pass.pool.widest;
        run_f32(pass, widest);
    }
}

impl Passes for f64 {
    fn forward(pass: Forward<f64>) {
        pass.run(Portable);
    }

    fn backward(pass: Backward<f64>) {
        pass.run(Portable);
    }

    fn pool(pass: Pooling<f64>) {
        pass.run(Portable);
    }

    fn unpool(pass: Unpooling<f64>) {
        pass.run(Portable);
    }
}

/// The length of the scratch of both passes; `staged` says whether the input is.
pub(crate) fn scratch_len(conv: &R2Conv, samples: usize, staged: bool) -> usize {
    let forward = forward::scratch_len(conv, samples, staged);
    forward.max(backward::scratch_len(conv, samples, staged))
}

impl<T: Passes> Forward<'_, T> {
    /// Runs the pass: that of a single image in two halves, which have the same bits, if a thread
    /// of the current rayon pool may be free for one of them.
    pub(crate) fn run_on_threads(self) {
        let products = self.conv.out.pixels() * self.conv.weights.blocks() * LANES;
        let worth = self.samples == 1 && self.conv.out.height > 1 && products >= SPLIT;
        let threads = match rayon::current_thread_index() {
            Some(_) if !in_one_of_many_chunks() => rayon::current_num_threads(),
            _ => 1,
        };
        if worth && threads > 1 {
            let (above, below) = self.halves();
            rayon::join(|| T::forward(above), || T::forward(below));
        } else {
            T::forward(self);
        }
    }
}

impl<T: Real> WithLanes<T> for Forward<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        if let Some(lines) = self.conv.patches.lines() {
            return self.run_lines(lanes, lines);
        }
        with_order!(G = self.conv.weights.order(), self.run_panels::<L, G>(lanes));
    }
}

impl<T: Real> WithLanes<T> for Backward<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        if let (Some(lines), None) = (self.conv.patches.lines(), &self.dx) {
            return self.run_lines(lanes, lines);
        }
        with_order!(G = self.conv.weights.order(), self.run_panels::<L, G>(lanes));
    }
}

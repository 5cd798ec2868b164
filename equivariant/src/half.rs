//! Half precision, where the processor has it.

use crate::conv::geometry::Conv;
#[cfg(target_arch = "x86_64")]
use crate::conv::half as instructions;
use crate::conv::pass::{Backward, Forward};

/// Proof that this processor multiplies matrices of bfloat16: Intel's AMX (AMX-BF16, with
/// AVX512-BF16), which Linux lets a process use.
///
/// Layers in half precision ([`R2Conv::in_half`](crate::R2Conv::in_half)) round what the products
/// of convolutions read to bfloat16, which keeps eight bits of a number: folds of patches, weights
/// and output gradients. Maps, parameters, gradients and the sums of the products stay in single
/// precision, as do first layers of trivial channels under D2. Rounding commutes with signs, so
/// equivariance is as exact as without.
#[derive(Clone, Copy, Debug)]
pub struct Half(instructions::Instructions);

impl Half {
    /// The proof; none if the processor or the system lacks what it takes.
    pub fn available() -> Option<Half> {
        instructions::Instructions::new().map(Half)
    }

    pub(crate) fn forward(self, pass: Forward<f32>) {
        self.0.forward(pass);
    }

    pub(crate) fn backward(self, pass: Backward<f32>) {
        self.0.backward(pass);
    }
}

/// Blocks of scratch that half precision takes in a forward pass.
pub(crate) fn forward_blocks(conv: &Conv) -> usize {
    conv.half.map_or(0, |_| instructions::forward_blocks(conv))
}

/// Blocks of scratch that half precision takes in a backward pass.
pub(crate) fn backward_blocks(conv: &Conv) -> usize {
    conv.half.map_or(0, |_| instructions::backward_blocks(conv))
}

/// What other processors have for it: nothing.
#[cfg(not(target_arch = "x86_64"))]
mod instructions {
    use super::*;

    #[derive(Clone, Copy, Debug)]
    pub enum Instructions {}

    impl Instructions {
        pub fn new() -> Option<Instructions> {
            None
        }

        pub fn forward(self, _: Forward<f32>) {
            match self {}
        }

        pub fn backward(self, _: Backward<f32>) {
            match self {}
        }
    }

    pub fn forward_blocks(_: &Conv) -> usize {
        0
    }

    pub fn backward_blocks(_: &Conv) -> usize {
        0
    }
}

//! Half precision, where the processor has it.

#[cfg(target_arch = "x86_64")]
use pulp::x86::V4;

#[cfg(target_arch = "x86_64")]
use crate::simd::amx::Amx;

/// Proof that this processor multiplies matrices of bfloat16: Intel's AMX (AMX-BF16, with
/// AVX512-BF16), which Linux lets a process use.
///
/// Layers in half precision ([`R2Conv::in_half`](crate::R2Conv::in_half)) round what the products
/// of convolutions read to bfloat16, which keeps eight bits of a number: folds of patches, weights
/// and output gradients. Maps, parameters, gradients and the sums of the products stay in single
/// precision. So do, of trivial channels under D2, forward passes, and backward passes that are not
/// asked for the gradient of the input: a network's first layer. Rounding commutes with signs, so
/// equivariance is as exact as without.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct Half {
    pub(crate) simd: V4,
    pub(crate) amx: Amx,
}

/// Half precision, which only some processors of another architecture have.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Clone, Copy, Debug)]
pub enum Half {}

impl Half {
    /// The proof; none if the processor or the system lacks what it takes.
    #[cfg(target_arch = "x86_64")]
    pub fn available() -> Option<Half> {
        let (simd, amx) = (V4::try_new()?, Amx::new()?);
        Some(Half { simd, amx })
    }

    /// None.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn available() -> Option<Half> {
        None
    }
}

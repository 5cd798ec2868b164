//! The instruction sets that there are kernels for.

use crate::simd::lanes::{Lanes, WithLanes, run_f32};

/// What convolutions run on in single precision, from narrow to wide. They take the widest that the
/// processor has, unless they are told otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum InstructionSet {
    /// What every processor has.
    Portable,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 with its extensions DQ and VL.
    Avx512,
}

impl InstructionSet {
    /// All of them, from narrow to wide.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Whether this processor has it.
    pub fn is_available(self) -> bool {
        run_f32(Nothing, self) == self
    }
}

/// Work that does nothing.
struct Nothing;

impl WithLanes<f32> for Nothing {
    fn run<L: Lanes<f32>>(self, _lanes: L) {}
}

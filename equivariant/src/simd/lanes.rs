//! Vectors of sixteen numbers, on the instruction set of the CPU.

use crate::real::{Real, exceeds_or_is_nan};

/// CPU instruction set for convolutions in single precision; variants are in ascending order of
/// width. The default is the widest that the CPU has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum InstructionSet {
    /// Instructions that every CPU has.
    Portable,
    /// AVX2 and FMA, with vectors of 8 numbers.
    Avx2,
    /// AVX-512 with its extensions DQ and VL, with vectors of 16 numbers.
    Avx512,
}

impl InstructionSet {
    /// All instruction sets in ascending order of width.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Returns `true` if this CPU has the instruction set.
    pub fn is_available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86;

/// Number of values that a CPU kernel handles at once: an AVX-512 register of single precision.
pub(crate) const LANES: usize = 16;

/// Block of sixteen numbers, the unit that kernels load and store.
pub(crate) type Block<T> = [T; LANES];

/// Arithmetic on vectors of sixteen numbers (lanes) with one CPU instruction set.
///
/// Lanes come in groups of G = 1, 2 or 4 neighbours, one lane for each irrep.
pub(crate) trait Lanes<T>: Copy {
    /// Sixteen numbers in registers.
    type V: Copy;
    /// Number of vectors of sixteen lanes that the registers hold.
    const REGISTERS: usize;

    /// Loads a block of sixteen numbers into registers.
    fn load(self, block: &Block<T>) -> Self::V;
    /// Converts sixteen bytes to numbers.
    fn load_bytes(self, bytes: &[u8; LANES]) -> Self::V;
    /// Stores sixteen numbers from registers in a block.
    fn store(self, block: &mut Block<T>, v: Self::V);
    /// Repeats a number in all lanes.
    fn splat(self, value: T) -> Self::V;
    /// Repeats group `i` of G neighbouring lanes of the block in all groups.
    fn broadcast_group<const G: usize>(self, block: &Block<T>, i: usize) -> Self::V;
    /// Repeats four numbers in every group of four lanes.
    fn broadcast_quad(self, group: &[T; 4]) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// Returns a b + c, with one rounding where the instruction set has fused operations.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Swaps lanes: lane i receives lane i xor `bits`, for `bits` in 0..4.
    fn swap_lanes(self, v: Self::V, bits: usize) -> Self::V;
    /// Returns four groups `[e, e, o, o]`, one for each of the lanes 4 i to 4 i + 3 of the
    /// registers `e` and `o`.
    fn interleave_pair(self, e: Self::V, o: Self::V, i: usize) -> Self::V;
    /// Zeroes lanes that are at most zero and returns the bit mask of the others, NaN among them.
    fn relu_with_mask(self, v: Self::V) -> (Self::V, u16);
    /// Zeroes the lanes whose bit in `bits` is not set.
    fn keep_masked(self, v: Self::V, bits: u16) -> Self::V;
    /// Returns the larger number of each lane and the bit mask of the lanes that `v` wins: `best`
    /// wins ties, and NaN wins over every number.
    fn max_with_mask(self, best: Self::V, v: Self::V) -> (Self::V, u16);
}

/// Computation that is written once, generically, for all CPU instruction sets.
pub(crate) trait WithLanes<T> {
    /// Runs the computation on an instruction set.
    fn run<L: Lanes<T>>(self, lanes: L);
}

/// Runs a computation in single precision on the widest instruction set that the CPU has, up
/// to `widest`.
pub(crate) fn run_f32(work: impl WithLanes<f32>, widest: InstructionSet) {
    #[cfg(target_arch = "x86_64")]
    {
        if widest >= InstructionSet::Avx512
            && let Some(simd) = pulp::x86::V4::try_new()
        {
            return simd.vectorize(x86::OnInstructionSet { simd, work });
        }
        if widest >= InstructionSet::Avx2
            && let Some(simd) = pulp::x86::V3::try_new()
        {
            return simd.vectorize(x86::OnInstructionSet { simd, work });
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = widest;
    work.run(Portable);
}

/// Returns the Walsh-Hadamard transform within groups of G lanes, without its factor 1/sqrt(G).
#[inline(always)]
pub(crate) fn unscaled_hadamard<T: Real, L: Lanes<T>, const G: usize>(
    lanes: L,
    mut v: L::V,
) -> L::V {
    if G > 1 {
        // one multiplication by signs replaces separate sums and differences of lanes
        v = lanes.mul_add(v, signs(lanes, 1), lanes.swap_lanes(v, 1));
    }
    if G > 2 {
        v = lanes.mul_add(v, signs(lanes, 2), lanes.swap_lanes(v, 2));
    }
    v
}

/// Returns -1 for lanes whose index has the bit `bit`, and 1 for the others.
#[inline(always)]
fn signs<T: Real, L: Lanes<T>>(lanes: L, bit: usize) -> L::V {
    let mut signs = [T::from_f64(1.0); LANES];
    for (lane, sign) in signs.iter_mut().enumerate() {
        if lane & bit != 0 {
            *sign = T::from_f64(-1.0);
        }
    }
    lanes.load(&signs)
}

/// Portable lanes: arrays of sixteen numbers, for every CPU and both precisions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Portable;

impl<T: Real> Lanes<T> for Portable {
    type V = Block<T>;
    // sixteen registers of four numbers, as every x86-64 CPU has
    const REGISTERS: usize = 4;

    #[inline(always)]
    fn load(self, block: &Block<T>) -> Block<T> {
        *block
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; LANES]) -> Block<T> {
        std::array::from_fn(|lane| T::from_f64(f64::from(bytes[lane])))
    }

    #[inline(always)]
    fn store(self, block: &mut Block<T>, v: Block<T>) {
        *block = v;
    }

    #[inline(always)]
    fn splat(self, value: T) -> Block<T> {
        [value; LANES]
    }

    #[inline(always)]
    fn broadcast_group<const G: usize>(self, block: &Block<T>, i: usize) -> Block<T> {
        std::array::from_fn(|lane| block[i * G + lane % G])
    }

    #[inline(always)]
    fn broadcast_quad(self, group: &[T; 4]) -> Block<T> {
        std::array::from_fn(|lane| group[lane % 4])
    }

    #[inline(always)]
    fn add(self, a: Block<T>, b: Block<T>) -> Block<T> {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn sub(self, a: Block<T>, b: Block<T>) -> Block<T> {
        std::array::from_fn(|lane| a[lane] - b[lane])
    }

    #[inline(always)]
    fn mul(self, a: Block<T>, b: Block<T>) -> Block<T> {
        std::array::from_fn(|lane| a[lane] * b[lane])
    }

    #[inline(always)]
    fn mul_add(self, a: Block<T>, b: Block<T>, c: Block<T>) -> Block<T> {
        std::array::from_fn(|lane| a[lane] * b[lane] + c[lane])
    }

    #[inline(always)]
    fn swap_lanes(self, v: Block<T>, bits: usize) -> Block<T> {
        std::array::from_fn(|lane| v[lane ^ bits])
    }

    #[inline(always)]
    fn interleave_pair(self, e: Block<T>, o: Block<T>, i: usize) -> Block<T> {
        let of = |lane: usize| if lane & 2 == 0 { &e } else { &o };
        std::array::from_fn(|lane| of(lane)[4 * i + lane / 4])
    }

    #[inline(always)]
    fn relu_with_mask(self, v: Block<T>) -> (Block<T>, u16) {
        let dropped = v.map(|x| x <= T::ZERO);
        let bits = (0..LANES).map(|lane| u16::from(!dropped[lane]) << lane);
        let kept = |lane: usize| if dropped[lane] { T::ZERO } else { v[lane] };
        (std::array::from_fn(kept), bits.sum())
    }

    #[inline(always)]
    fn keep_masked(self, v: Block<T>, bits: u16) -> Block<T> {
        let kept = |lane: usize| bits >> lane & 1 == 1;
        std::array::from_fn(|lane| if kept(lane) { v[lane] } else { T::ZERO })
    }

    #[inline(always)]
    fn max_with_mask(self, best: Block<T>, v: Block<T>) -> (Block<T>, u16) {
        let won = |lane: usize| exceeds_or_is_nan(v[lane], best[lane]);
        let bits = (0..LANES).map(|lane| u16::from(won(lane)) << lane).sum();
        let larger = |lane| if won(lane) { v[lane] } else { best[lane] };
        (std::array::from_fn(larger), bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Registers<'a>(&'a mut usize);

    impl WithLanes<f32> for Registers<'_> {
        fn run<L: Lanes<f32>>(self, _: L) {
            *self.0 = L::REGISTERS;
        }
    }

    #[test]
    fn work_runs_on_the_instruction_set_that_is_asked_for() {
        let registers = [4, 8, 32];
        for (set, expected) in InstructionSet::ALL.into_iter().zip(registers) {
            if set.is_available() {
                let mut found = 0;
                run_f32(Registers(&mut found), set);
                assert_eq!(found, expected, "{set:?}");
            }
        }
    }
}

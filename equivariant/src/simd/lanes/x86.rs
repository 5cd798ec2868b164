//! AVX-512 and AVX2 lanes through the safe intrinsics of `pulp`.

use std::arch::x86_64::{__m256, __m512, _CMP_GT_OQ, _CMP_UNORD_Q};

use pulp::x86::{V3, V4};
use pulp::{NullaryFnOnce, cast};

use crate::simd::lanes::{Block, LANES, Lanes, WithLanes};

/// Computation together with the instruction set on which it runs: AVX-512, or AVX2 and FMA.
pub(super) struct OnInstructionSet<S, W> {
    pub simd: S,
    pub work: W,
}

impl<S: Lanes<f32>, W: WithLanes<f32>> NullaryFnOnce for OnInstructionSet<S, W> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.work.run(self.simd);
    }
}

impl Lanes<f32> for V4 {
    type V = __m512;
    const REGISTERS: usize = 32;

    #[inline(always)]
    fn load(self, block: &Block<f32>) -> __m512 {
        cast(*block)
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; LANES]) -> __m512 {
        let whole = self.avx512f._mm512_cvtepu8_epi32(cast(*bytes));
        self.avx512f._mm512_cvtepi32_ps(whole)
    }

    #[inline(always)]
    fn store(self, block: &mut Block<f32>, v: __m512) {
        *block = cast(v);
    }

    #[inline(always)]
    fn splat(self, value: f32) -> __m512 {
        self.avx512f._mm512_set1_ps(value)
    }

    #[inline(always)]
    fn broadcast_group<const G: usize>(self, block: &Block<f32>, i: usize) -> __m512 {
        match G {
            1 => self.avx512f._mm512_set1_ps(block[i]),
            2 => {
                let pair: f64 = cast([block[2 * i], block[2 * i + 1]]);
                cast(self.avx512f._mm512_set1_pd(pair))
            }
            _ => self.broadcast_quad(&block.as_chunks().0[i]),
        }
    }

    #[inline(always)]
    fn broadcast_quad(self, group: &[f32; 4]) -> __m512 {
        self.avx512f._mm512_broadcast_f32x4(cast(*group))
    }

    #[inline(always)]
    fn add(self, a: __m512, b: __m512) -> __m512 {
        self.avx512f._mm512_add_ps(a, b)
    }

    #[inline(always)]
    fn sub(self, a: __m512, b: __m512) -> __m512 {
        self.avx512f._mm512_sub_ps(a, b)
    }

    #[inline(always)]
    fn mul(self, a: __m512, b: __m512) -> __m512 {
        self.avx512f._mm512_mul_ps(a, b)
    }

    #[inline(always)]
    fn mul_add(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        self.avx512f._mm512_fmadd_ps(a, b, c)
    }

    #[inline(always)]
    fn swap_lanes(self, v: __m512, bits: usize) -> __m512 {
        match bits {
            0 => v,
            // two bits of the constant select the source of each lane of a group of four
            1 => self.avx512f._mm512_permute_ps::<0b10_11_00_01>(v),
            2 => self.avx512f._mm512_permute_ps::<0b01_00_11_10>(v),
            _ => self.avx512f._mm512_permute_ps::<0b00_01_10_11>(v),
        }
    }

    #[inline(always)]
    fn interleave_pair(self, e: __m512, o: __m512, i: usize) -> __m512 {
        let first = self.avx512f._mm512_set1_epi32(4 * i as i32);
        // indices from 16 on select lanes of the second register
        let index = [0, 0, 16, 16, 1, 1, 17, 17, 2, 2, 18, 18, 3, 3, 19, 19];
        let index = self.avx512f._mm512_add_epi32(cast::<[i32; 16], _>(index), first);
        self.avx512f._mm512_permutex2var_ps(e, index, o)
    }

    #[inline(always)]
    fn relu_with_mask(self, v: __m512) -> (__m512, u16) {
        let bits = !self.avx512f._mm512_cmple_ps_mask(v, self.splat(0.0));
        (self.keep_masked(v, bits), bits)
    }

    #[inline(always)]
    fn keep_masked(self, v: __m512, bits: u16) -> __m512 {
        self.avx512f._mm512_maskz_mov_ps(bits, v)
    }

    #[inline(always)]
    fn max_with_mask(self, best: __m512, v: __m512) -> (__m512, u16) {
        // comparisons with NaN are false, so the second mask adds the lanes where v is NaN
        let more = self.avx512f._mm512_cmp_ps_mask::<_CMP_GT_OQ>(v, best);
        let bits = more | self.avx512f._mm512_cmp_ps_mask::<_CMP_UNORD_Q>(v, v);
        (self.avx512f._mm512_mask_mov_ps(best, bits, v), bits)
    }
}

impl Lanes<f32> for V3 {
    type V = [__m256; 2];
    const REGISTERS: usize = 8;

    #[inline(always)]
    fn load(self, block: &Block<f32>) -> Self::V {
        cast(*block)
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; LANES]) -> Self::V {
        let bytes: [u64; 2] = cast(*bytes);
        let low = self.avx2._mm256_cvtepu8_epi32(cast([bytes[0], 0]));
        let high = self.avx2._mm256_cvtepu8_epi32(cast([bytes[1], 0]));
        [self.avx._mm256_cvtepi32_ps(low), self.avx._mm256_cvtepi32_ps(high)]
    }

    #[inline(always)]
    fn store(self, block: &mut Block<f32>, v: Self::V) {
        *block = cast(v);
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        [self.avx._mm256_set1_ps(value); 2]
    }

    #[inline(always)]
    fn broadcast_group<const G: usize>(self, block: &Block<f32>, i: usize) -> Self::V {
        match G {
            1 => [self.avx._mm256_set1_ps(block[i]); 2],
            2 => {
                let pair: f64 = cast([block[2 * i], block[2 * i + 1]]);
                [cast(self.avx._mm256_set1_pd(pair)); 2]
            }
            _ => self.broadcast_quad(&block.as_chunks().0[i]),
        }
    }

    #[inline(always)]
    fn broadcast_quad(self, group: &[f32; 4]) -> Self::V {
        [self.avx._mm256_broadcast_ps(&cast(*group)); 2]
    }

    #[inline(always)]
    fn add(self, a: Self::V, b: Self::V) -> Self::V {
        [self.avx._mm256_add_ps(a[0], b[0]), self.avx._mm256_add_ps(a[1], b[1])]
    }

    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        [self.avx._mm256_sub_ps(a[0], b[0]), self.avx._mm256_sub_ps(a[1], b[1])]
    }

    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        [self.avx._mm256_mul_ps(a[0], b[0]), self.avx._mm256_mul_ps(a[1], b[1])]
    }

    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        [self.fma._mm256_fmadd_ps(a[0], b[0], c[0]), self.fma._mm256_fmadd_ps(a[1], b[1], c[1])]
    }

    #[inline(always)]
    fn swap_lanes(self, v: Self::V, bits: usize) -> Self::V {
        match bits {
            0 => v,
            1 => [
                self.avx._mm256_permute_ps::<0b10_11_00_01>(v[0]),
                self.avx._mm256_permute_ps::<0b10_11_00_01>(v[1]),
            ],
            2 => [
                self.avx._mm256_permute_ps::<0b01_00_11_10>(v[0]),
                self.avx._mm256_permute_ps::<0b01_00_11_10>(v[1]),
            ],
            _ => [
                self.avx._mm256_permute_ps::<0b00_01_10_11>(v[0]),
                self.avx._mm256_permute_ps::<0b00_01_10_11>(v[1]),
            ],
        }
    }

    #[inline(always)]
    fn interleave_pair(self, e: Self::V, o: Self::V, i: usize) -> Self::V {
        // groups k and k + 4 of eight lanes come from the two halves of a register
        let (e, o) = (e[i / 2], o[i / 2]);
        let first = self.avx._mm256_shuffle_ps::<0b00_00_00_00>(e, o);
        let second = self.avx._mm256_shuffle_ps::<0b01_01_01_01>(e, o);
        let third = self.avx._mm256_shuffle_ps::<0b10_10_10_10>(e, o);
        let fourth = self.avx._mm256_shuffle_ps::<0b11_11_11_11>(e, o);
        if i.is_multiple_of(2) {
            [
                self.avx._mm256_permute2f128_ps::<0x20>(first, second),
                self.avx._mm256_permute2f128_ps::<0x20>(third, fourth),
            ]
        } else {
            [
                self.avx._mm256_permute2f128_ps::<0x31>(first, second),
                self.avx._mm256_permute2f128_ps::<0x31>(third, fourth),
            ]
        }
    }

    #[inline(always)]
    fn relu_with_mask(self, v: Self::V) -> (Self::V, u16) {
        let zero = self.avx._mm256_set1_ps(0.0);
        // predicate "not less or equal, unordered", which is true for NaN
        let low = self.avx._mm256_cmp_ps::<0x16>(v[0], zero);
        let high = self.avx._mm256_cmp_ps::<0x16>(v[1], zero);
        let bits = self.avx._mm256_movemask_ps(low) | self.avx._mm256_movemask_ps(high) << 8;
        let v = [self.avx._mm256_and_ps(low, v[0]), self.avx._mm256_and_ps(high, v[1])];
        (v, bits as u16)
    }

    #[inline(always)]
    fn keep_masked(self, v: Self::V, bits: u16) -> Self::V {
        let bits = self.avx._mm256_set1_epi32(i32::from(bits));
        // AVX2 has no mask registers: lane i compares bit i with itself
        let low = cast([1, 2, 4, 8, 16, 32, 64, 128]);
        let high = self.avx2._mm256_slli_epi32::<8>(low);
        let low = self.avx2._mm256_cmpeq_epi32(self.avx2._mm256_and_si256(bits, low), low);
        let high = self.avx2._mm256_cmpeq_epi32(self.avx2._mm256_and_si256(bits, high), high);
        [self.avx._mm256_and_ps(v[0], cast(low)), self.avx._mm256_and_ps(v[1], cast(high))]
    }

    #[inline(always)]
    fn max_with_mask(self, best: Self::V, v: Self::V) -> (Self::V, u16) {
        let avx = self.avx;
        let low = avx._mm256_cmp_ps::<_CMP_GT_OQ>(v[0], best[0]);
        let low = avx._mm256_or_ps(low, avx._mm256_cmp_ps::<_CMP_UNORD_Q>(v[0], v[0]));
        let high = avx._mm256_cmp_ps::<_CMP_GT_OQ>(v[1], best[1]);
        let high = avx._mm256_or_ps(high, avx._mm256_cmp_ps::<_CMP_UNORD_Q>(v[1], v[1]));
        let bits = avx._mm256_movemask_ps(low) | avx._mm256_movemask_ps(high) << 8;
        let larger =
            [avx._mm256_blendv_ps(best[0], v[0], low), avx._mm256_blendv_ps(best[1], v[1], high)];
        (larger, bits as u16)
    }
}

//! Products of matrices of bfloat16 in the tiles of AMX, and how their operands are packed.
//!
//! This is the only file of the crate with `unsafe`: Rust's standard library has no AMX, so the
//! products are assembly, and the packing needs instructions that `pulp` does not know.
//!
//! A *word* is two numbers in bfloat16 that a product multiplies one after the other. A *tile* is
//! sixteen rows of sixteen words, or of sixteen numbers in f32 where it holds sums. Blocks of the
//! kernels hold (field q, irrep r) in lane q G + r, and a product is of one irrep. So blocks are
//! rounded to words two at a time, and words are transposed among G of them, which leaves one
//! irrep in each: q G + j, for word j of the G.

#![allow(unsafe_code, reason = "assembly, and instructions of AVX512-BF16")]

use std::arch::asm;
use std::arch::x86_64::{
    __cpuid_count, __m512i, _mm512_cvtne2ps_pbh, _mm512_permutex2var_epi32,
    _mm512_permutexvar_epi16, _mm512_setzero_si512, _xgetbv,
};
use std::marker::PhantomData;

use crate::simd::lanes::{Block, LANES};

/// Rows of a tile, and blocks that hold it.
pub(crate) const TILE: usize = 16;
/// Rows of which a tile holds the words, two to a word.
pub(crate) const PAIRS: usize = 2 * TILE;

/// Blocks of zeros, where there are none.
const NONE: Block<f32> = [0.0; LANES];

/// Proof that the processor multiplies tiles of bfloat16 and that this process may.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amx(());

impl Amx {
    pub fn new() -> Option<Amx> {
        let bf16 = is_x86_feature_detected!("avx512bf16") && is_x86_feature_detected!("avx512bw");
        // bits 22 and 24: AMX-BF16 and AMX-TILE
        let has = bf16 && __cpuid_count(7, 0).edx >> 22 & 0b101 == 0b101;
        (has && may_use_tiles()).then_some(Amx(()))
    }

    /// Configures the tiles of this thread, of which there may be one owner at a time.
    pub fn tiles(self) -> Tiles {
        let mut config = Config([0; 64]);
        config.0[0] = 1;
        for tile in 0..8 {
            config.0[16 + 2 * tile] = 64;
            config.0[48 + tile] = TILE as u8;
        }
        // SAFETY: `self` proves that the instruction may run; palette 1 has eight tiles of 16 rows
        // of 64 bytes.
        unsafe { asm!("ldtilecfg [{}]", in(reg) &config, options(nostack, readonly)) };
        Tiles(PhantomData)
    }
}

/// What configures the tiles.
#[repr(C, align(64))]
struct Config([u8; 64]);

/// Whether the system saves tiles, and lets this process use them.
fn may_use_tiles() -> bool {
    const SYSCALL_ARCH_PRCTL: i64 = 158;
    const REQUEST_PERMISSION: i64 = 0x1023;
    const TILE_DATA: i64 = 18;
    if !cfg!(target_os = "linux") || !is_x86_feature_detected!("xsave") {
        return false;
    }
    // SAFETY: `xsave` is there, and the system lets programs ask, since Rust has asked as well.
    let saved = unsafe { saved_state() };
    if saved >> 17 & 0b11 != 0b11 {
        return false;
    }
    let refused: i64;
    // SAFETY: a call of Linux that reads no memory; it clobbers rcx and r11.
    unsafe {
        asm!("syscall", inlateout("rax") SYSCALL_ARCH_PRCTL => refused,
            in("rdi") REQUEST_PERMISSION, in("rsi") TILE_DATA,
            out("rcx") _, out("r11") _, options(nostack));
    }
    refused == 0
}

#[target_feature(enable = "xsave")]
fn saved_state() -> u64 {
    // SAFETY: register 0 is there where `xsave` is.
    unsafe { _xgetbv(0) }
}

/// The configured tiles of a thread, which it releases in the end.
pub(crate) struct Tiles(PhantomData<*mut ()>);

impl Drop for Tiles {
    fn drop(&mut self) {
        // SAFETY: who made them proved that the instruction may run.
        unsafe { asm!("tilerelease", options(nostack, nomem)) };
    }
}

/// The operands of some products of tiles, `[step][factor]` each: product i is the sum over all
/// steps of factor i of a times factor i of b, which begin anew when they end.
#[derive(Clone, Copy)]
pub(crate) struct Factors<'a> {
    pub a: &'a [Block<f32>],
    /// Factors of a for each step.
    pub of_a: usize,
    pub b: &'a [Block<f32>],
    /// Factors of b for each step.
    pub of_b: usize,
    pub steps: usize,
}

/// The function that computes some products side by side: a step of one waits for its last.
macro_rules! side_by_side {
    ($name:ident: $(($c:literal, $ta:literal, $tb:literal, $a:ident, $i:literal)),+) => {
        /// # Safety
        /// The tiles are configured; a points to as many tiles, b and c to as many in a row, in
        /// all steps, and the last to tiles that may be written.
        #[inline(always)]
        unsafe fn $name(
            a: [*const Block<f32>; 4],
            b: *const Block<f32>,
            c: *mut Block<f32>,
            [steps, a_step, b_step]: [usize; 3],
            add: bool,
        ) {
            // SAFETY: as the caller promises.
            unsafe {
                asm!(
                    "test {add}, {add}",
                    "jz 3f",
                    $(concat!("tileloadd ", $c, ", [{c} + {line}*1 + 1024*", $i, "]"),)+
                    "jmp 2f",
                    "3:",
                    $(concat!("tilezero ", $c),)+
                    "2:",
                    $(
                        concat!("tileloadd ", $ta, ", [{", stringify!($a), "} + {line}*1]"),
                        concat!("tileloadd ", $tb, ", [{b} + {line}*1 + 1024*", $i, "]"),
                        concat!("tdpbf16ps ", $c, ", ", $ta, ", ", $tb),
                        concat!("add {", stringify!($a), "}, {a_step}"),
                    )+
                    "add {b}, {b_step}",
                    "dec {steps}",
                    "jnz 2b",
                    $(concat!("tilestored [{c} + {line}*1 + 1024*", $i, "], ", $c),)+
                    $($a = inout(reg) a[$i] => _,)+
                    b = inout(reg) b => _,
                    c = in(reg) c,
                    line = in(reg) 64usize,
                    steps = inout(reg) steps => _,
                    a_step = in(reg) a_step,
                    b_step = in(reg) b_step,
                    add = in(reg) usize::from(add),
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                );
            }
        }
    };
}

side_by_side!(four: ("tmm0", "tmm4", "tmm5", a0, 0), ("tmm1", "tmm6", "tmm7", a1, 1),
    ("tmm2", "tmm4", "tmm5", a2, 2), ("tmm3", "tmm6", "tmm7", a3, 3));
side_by_side!(two: ("tmm0", "tmm4", "tmm5", a0, 0), ("tmm1", "tmm6", "tmm7", a1, 1));
side_by_side!(one: ("tmm0", "tmm4", "tmm5", a0, 0));

impl Tiles {
    /// Writes products to tiles of sums, or adds them.
    #[inline(always)]
    pub fn multiply(&self, factors: Factors, sums: &mut [Block<f32>], add: bool) {
        let Factors {
            a,
            of_a,
            b,
            of_b,
            steps,
        } = factors;
        let products = sums.len() / TILE;
        assert!(steps > 0 && a.len() >= steps * of_a * TILE && b.len() >= steps * of_b * TILE);
        assert!(sums.len() == products * TILE && (products <= of_b || products % of_b == 0));
        let together = match (products, of_b) {
            (n, m) if n % 4 == 0 && m % 4 == 0 => 4,
            (n, m) if n % 2 == 0 && m % 2 == 0 => 2,
            _ => 1,
        };
        let tile_len = size_of::<[Block<f32>; TILE]>();
        let lengths = [steps, of_a * tile_len, of_b * tile_len];
        for first in (0..products).step_by(together) {
            // factors past the last product are loaded by none
            let a: [_; 4] = std::array::from_fn(|i| &raw const a[(first + i) % of_a * TILE]);
            let b = &raw const b[first % of_b * TILE];
            let c = &raw mut sums[first * TILE];
            // SAFETY: the tiles are configured while `self` is there. By the first assertion a and
            // b hold the factors of all steps. As many factors of b as are taken together lie in a
            // row, since that number divides theirs, and as many tiles of sums.
            unsafe {
                match together {
                    4 => four(a, b, c, lengths, add),
                    2 => two(a, b, c, lengths, add),
                    _ => one(a, b, c, lengths, add),
                }
            }
        }
    }
}

/// A method of the proof that calls the packing of the same name.
macro_rules! packed_by {
    ($($(#[$doc:meta])* $name:ident($($arg:ident: $of:ty),*);)+) => {
        impl Amx {
            $($(#[$doc])*
            pub fn $name<const G: usize>(self, $($arg: $of),*) {
                // SAFETY: `self` proves that the processor has AVX512-BF16 and what it extends.
                unsafe { packing::$name::<G>($($arg),*) }
            })+
        }
    };
}

packed_by! {
    /// Rows of `[block][row]`, `step` apart, whose words are pairs of blocks, to factors `[tile of
    /// rows][step][irrep]`.
    pack_rows(x: &[Block<f32>], step: usize, rows: usize, to: &mut [Block<f32>]);
    /// Weights `[group][block]` that rows of panels meet: `[step][G blocks][irrep]`.
    pack_weights(w: &[Block<f32>], width: usize, to: &mut [Block<f32>]);
    /// Weights of folds that rows of output gradients meet, `[step][irrep]`; `at` is the group of
    /// each column.
    pack_transposed(w: &[Block<f32>], width: usize, at: [Option<usize>; TILE], to: &mut [Block<f32>]);
    /// Folds `[fold][row]`, whose words are pairs of rows, to factors `[step][irrep]`.
    pack_pairs(x: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Output gradients `[block][row]`, whose words are pairs of rows, one to a column, to factors
    /// `[step][G blocks][irrep]`.
    pack_across(dy: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Sums `[G blocks][irrep]` to rows `[row][block]`.
    unpack_rows(sums: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Sums `[irrep]` to rows `[block][row]`.
    unpack_columns(sums: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Adds sums `[G blocks][irrep]`, whose rows are output fields, to gradients `[group][block]`;
    /// `at` is the group of each column.
    add_transposed(sums: &[Block<f32>], at: [Option<usize>; TILE], dw: &mut [Block<f32>], width: usize);
}

/// Safe functions of processors that have AVX512-BF16.
mod packing {
    use super::*;

    /// For each bit, which lanes the two halves of a transposition take from two registers.
    const SWAPS: [[[i32; LANES]; 2]; 4] = {
        let mut swaps = [[[0; LANES]; 2]; 4];
        let mut bit = 0;
        while bit < 4 {
            let mut lane = 0;
            while lane < LANES {
                let set = lane >> bit & 1 == 1;
                let other = (lane ^ (1 << bit)) as i32;
                let of_second = LANES as i32;
                swaps[bit][0][lane] = if set { other + of_second } else { lane as i32 };
                swaps[bit][1][lane] = if set { lane as i32 + of_second } else { other };
                lane += 1;
            }
            bit += 1;
        }
        swaps
    };

    /// Words from the numbers of two blocks.
    const WORDS: [u16; 2 * LANES] = {
        let mut words = [0; 2 * LANES];
        let mut i = 0;
        while i < LANES {
            (words[2 * i], words[2 * i + 1]) = (i as u16, (LANES + i) as u16);
            i += 1;
        }
        words
    };

    /// Two blocks, rounded to bfloat16, as words.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    fn words(a: &Block<f32>, b: &Block<f32>) -> __m512i {
        let both = _mm512_cvtne2ps_pbh(pulp::cast(*b), pulp::cast(*a));
        // SAFETY: 512 bits, of which every pattern is one of theirs.
        let both = unsafe { std::mem::transmute::<_, __m512i>(both) };
        _mm512_permutexvar_epi16(pulp::cast(WORDS), both)
    }

    /// Swaps the lower bits of lanes and the numbers of registers: an involution.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    fn transpose<const N: usize>(mut v: [__m512i; N]) -> [__m512i; N] {
        let mut bit = 0;
        while 1 << bit < N {
            let [low, high] = SWAPS[bit].map(pulp::cast);
            for i in 0..N {
                if i >> bit & 1 == 0 {
                    let (a, b) = (v[i], v[i + (1 << bit)]);
                    v[i] = _mm512_permutex2var_epi32(a, low, b);
                    v[i + (1 << bit)] = _mm512_permutex2var_epi32(a, high, b);
                }
            }
            bit += 1;
        }
        v
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn pack_rows<const G: usize>(
        x: &[Block<f32>],
        step: usize,
        rows: usize,
        to: &mut [Block<f32>],
    ) {
        let steps = (x.len() / step).div_ceil(2 * G);
        for (chunk, x) in x.chunks(2 * G * step).enumerate() {
            for row in 0..rows {
                let mut v = [_mm512_setzero_si512(); G];
                for (v, pair) in v.iter_mut().zip(x.chunks(2 * step)) {
                    *v = words(&pair[row], pair.get(step + row).unwrap_or(&NONE));
                }
                let tile = (row / TILE * steps + chunk) * G;
                for (r, v) in transpose(v).into_iter().enumerate() {
                    to[(tile + r) * TILE + row % TILE] = pulp::cast(v);
                }
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn pack_weights<const G: usize>(w: &[Block<f32>], width: usize, to: &mut [Block<f32>]) {
        let per_block = LANES / G;
        let tiles = width.div_ceil(G);
        for (chunk, w) in w.chunks(2 * LANES * width).enumerate() {
            for (pair, w) in w.chunks(2 * per_block * width).enumerate() {
                let (a, b) = w.split_at(per_block * width);
                for q in 0..per_block {
                    for t in 0..tiles {
                        let mut v = [_mm512_setzero_si512(); G];
                        for (j, v) in v.iter_mut().enumerate().take(width - t * G) {
                            let at = q * width + t * G + j;
                            *v = words(&a[at], b.get(at).unwrap_or(&NONE));
                        }
                        let tile = (chunk * tiles + t) * G;
                        for (r, v) in transpose(v).into_iter().enumerate() {
                            to[(tile + r) * TILE + q * G + pair] = pulp::cast(v);
                        }
                    }
                }
            }
        }
        zero_rest::<G>(w.len() / width, tiles, to);
    }

    /// Zeros for the pairs of blocks that the last step of weights lacks.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    fn zero_rest<const G: usize>(groups: usize, tiles: usize, to: &mut [Block<f32>]) {
        let pairs = (groups * G / LANES).div_ceil(2);
        for pair in pairs..pairs.next_multiple_of(G) {
            for tile in pair / G * tiles * G..(pair / G + 1) * tiles * G {
                for q in 0..LANES / G {
                    to[tile * TILE + q * G + pair % G] = NONE;
                }
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn pack_transposed<const G: usize>(
        w: &[Block<f32>],
        width: usize,
        at: [Option<usize>; TILE],
        to: &mut [Block<f32>],
    ) {
        for pair in 0..width.div_ceil(2 * G) * G {
            let mut v = [_mm512_setzero_si512(); TILE];
            for (v, group) in v.iter_mut().zip(at) {
                if let Some(group) = group
                    && 2 * pair < width
                {
                    let w = &w[group * width..][..width];
                    *v = words(&w[2 * pair], w.get(2 * pair + 1).unwrap_or(&NONE));
                }
            }
            for (lane, v) in transpose(v).into_iter().enumerate() {
                let tile = pair / G * G + lane % G;
                to[tile * TILE + lane / G * G + pair % G] = pulp::cast(v);
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn pack_pairs<const G: usize>(x: &[Block<f32>], rows: usize, to: &mut [Block<f32>]) {
        for pair in 0..rows.next_multiple_of(PAIRS) / 2 {
            let mut v = [_mm512_setzero_si512(); G];
            if 2 * pair < rows {
                for (v, x) in v.iter_mut().zip(x.chunks(rows)) {
                    *v = words(&x[2 * pair], x.get(2 * pair + 1).unwrap_or(&NONE));
                }
            }
            for (r, v) in transpose(v).into_iter().enumerate() {
                to[(pair / TILE * G + r) * TILE + pair % TILE] = pulp::cast(v);
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn pack_across<const G: usize>(dy: &[Block<f32>], rows: usize, to: &mut [Block<f32>]) {
        let tiles = (dy.len() / rows).div_ceil(G);
        for step in 0..rows.div_ceil(PAIRS) {
            for block in 0..tiles * G {
                let mut v = [_mm512_setzero_si512(); TILE];
                if let Some(dy) = dy.get(block * rows..(block + 1) * rows) {
                    for (v, pair) in v.iter_mut().zip(dy[step * PAIRS..].chunks(2)) {
                        *v = words(&pair[0], pair.get(1).unwrap_or(&NONE));
                    }
                }
                for (lane, v) in transpose(v).into_iter().enumerate() {
                    let tile = (step * tiles + block / G) * G + lane % G;
                    to[tile * TILE + lane / G * G + block % G] = pulp::cast(v);
                }
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn unpack_rows<const G: usize>(sums: &[Block<f32>], rows: usize, to: &mut [Block<f32>]) {
        let width = to.len() / rows;
        for (t, sums) in sums.chunks(G * TILE).enumerate() {
            for row in 0..rows {
                let to = &mut to[row * width..][..width][t * G..];
                for (v, to) in of_irreps::<G>(sums, row).into_iter().zip(to) {
                    *to = pulp::cast(v);
                }
            }
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn unpack_columns<const G: usize>(sums: &[Block<f32>], rows: usize, to: &mut [Block<f32>]) {
        for row in 0..rows {
            for (v, to) in of_irreps::<G>(sums, row)
                .into_iter()
                .zip(to.chunks_mut(rows))
            {
                to[row] = pulp::cast(v);
            }
        }
    }

    /// One row of the sums of all irreps, as blocks.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    fn of_irreps<const G: usize>(sums: &[Block<f32>], row: usize) -> [__m512i; G] {
        let mut v = [_mm512_setzero_si512(); G];
        for (v, sums) in v.iter_mut().zip(sums.as_chunks::<TILE>().0) {
            *v = pulp::cast(sums[row]);
        }
        transpose(v)
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
    pub fn add_transposed<const G: usize>(
        sums: &[Block<f32>],
        at: [Option<usize>; TILE],
        dw: &mut [Block<f32>],
        width: usize,
    ) {
        for (t, sums) in sums.chunks(G * TILE).enumerate() {
            let mut columns = [[_mm512_setzero_si512(); TILE]; G];
            for (columns, sums) in columns.iter_mut().zip(sums.as_chunks::<TILE>().0) {
                *columns = transpose(sums.map(pulp::cast));
            }
            for (n, group) in at.into_iter().enumerate() {
                let Some(group) = group else { continue };
                let mut v = [_mm512_setzero_si512(); G];
                for (v, columns) in v.iter_mut().zip(&columns) {
                    *v = columns[n];
                }
                let dw = &mut dw[group * width..][..width][t * G..];
                for (v, dw) in transpose(v).into_iter().zip(dw) {
                    let v: Block<f32> = pulp::cast(v);
                    for (dw, v) in dw.iter_mut().zip(v) {
                        *dw += v;
                    }
                }
            }
        }
    }
}

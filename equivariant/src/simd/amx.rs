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

mod packing;

use std::arch::asm;
use std::arch::x86_64::{
    __cpuid_count, __m512bh, __m512i, _mm512_cvtne2ps_pbh, _mm512_permutexvar_epi16, _xgetbv,
};
use std::cell::Cell;
use std::marker::PhantomData;

use crate::simd::lanes::{Block, LANES, TILE};

/// Blocks of zeros, where there are none.
const NONE: Block<f32> = [0.0; LANES];

/// Proof that the processor multiplies tiles of bfloat16 and that this process may.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amx(());

impl Amx {
    pub fn new() -> Option<Amx> {
        let bf16 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512bf16");
        // bits 22 and 24: AMX-BF16 and AMX-TILE
        let has = bf16 && __cpuid_count(7, 0).edx >> 22 & 0b101 == 0b101;
        (has && may_use_tiles()).then_some(Amx(()))
    }

    /// Configures the tiles of this thread, which have one owner at a time.
    pub fn tiles(self) -> Tiles {
        OWNED.with(|owned| assert!(!owned.replace(true), "the tiles have an owner"));
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

thread_local! {
    /// Whether the tiles of this thread have an owner.
    static OWNED: Cell<bool> = const { Cell::new(false) };
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
        OWNED.with(|owned| owned.set(false));
    }
}

/// The operands of the products of every row of tiles of a with every column of tiles of b, for
/// all irreps. Distances are in tiles; those of the irreps are neighbours.
#[derive(Clone, Copy)]
pub(crate) struct Factors<'a> {
    pub a: &'a [Block<f32>],
    pub rows: usize,
    /// From a row to the next, and from a step to the next.
    pub a_apart: [usize; 2],
    pub b: &'a [Block<f32>],
    pub columns: usize,
    /// From a column to the next, and from a step to the next.
    pub b_apart: [usize; 2],
    pub steps: usize,
}

/// Bytes of a row of a tile, and of a tile.
const ROW: usize = size_of::<Block<f32>>();
const TILE_LEN: usize = TILE * ROW;

/// Where the operands of one or of two products lie, which share a column.
struct Operands {
    a: [*const Block<f32>; 2],
    b: *const Block<f32>,
    c: [*mut Block<f32>; 2],
    /// Their number, and bytes from one to the next.
    steps: usize,
    a_step: usize,
    b_step: usize,
}

/// One product.
///
/// # Safety
/// The tiles are configured, and the operands point to tiles, the sums to such that may be written.
#[inline(always)]
unsafe fn one(operands: Operands, add: bool) {
    // SAFETY: as the caller promises.
    unsafe {
        asm!(
            "tilezero tmm0",
            "test {add}, {add}",
            "jz 2f",
            "tileloadd tmm0, [{c} + {row}*1]",
            "2:",
            "tileloadd tmm4, [{a} + {row}*1]",
            "tileloadd tmm6, [{b} + {row}*1]",
            "tdpbf16ps tmm0, tmm4, tmm6",
            "add {a}, {a_step}",
            "add {b}, {b_step}",
            "dec {steps}",
            "jnz 2b",
            "tilestored [{c} + {row}*1], tmm0",
            a = inout(reg) operands.a[0] => _,
            b = inout(reg) operands.b => _,
            c = in(reg) operands.c[0],
            row = in(reg) ROW,
            steps = inout(reg) operands.steps => _,
            a_step = in(reg) operands.a_step,
            b_step = in(reg) operands.b_step,
            add = in(reg) usize::from(add),
            out("tmm0") _, out("tmm4") _, out("tmm6") _,
            options(nostack),
        );
    }
}

/// The products of two rows with one column.
///
/// # Safety
/// As for [`one`].
#[inline(always)]
unsafe fn two(operands: Operands, add: bool) {
    // SAFETY: as the caller promises.
    unsafe {
        asm!(
            "tilezero tmm0",
            "tilezero tmm1",
            "test {add}, {add}",
            "jz 2f",
            "tileloadd tmm0, [{c0} + {row}*1]",
            "tileloadd tmm1, [{c1} + {row}*1]",
            "2:",
            "tileloadd tmm4, [{a0} + {row}*1]",
            "tileloadd tmm6, [{b} + {row}*1]",
            "tileloadd tmm5, [{a1} + {row}*1]",
            "tdpbf16ps tmm0, tmm4, tmm6",
            "tdpbf16ps tmm1, tmm5, tmm6",
            "add {a0}, {a_step}",
            "add {a1}, {a_step}",
            "add {b}, {b_step}",
            "dec {steps}",
            "jnz 2b",
            "tilestored [{c0} + {row}*1], tmm0",
            "tilestored [{c1} + {row}*1], tmm1",
            a0 = inout(reg) operands.a[0] => _,
            a1 = inout(reg) operands.a[1] => _,
            b = inout(reg) operands.b => _,
            c0 = in(reg) operands.c[0],
            c1 = in(reg) operands.c[1],
            row = in(reg) ROW,
            steps = inout(reg) operands.steps => _,
            a_step = in(reg) operands.a_step,
            b_step = in(reg) operands.b_step,
            add = in(reg) usize::from(add),
            out("tmm0") _, out("tmm1") _, out("tmm4") _, out("tmm5") _, out("tmm6") _,
            options(nostack),
        );
    }
}

/// The products of two rows with two columns, the second of which lies `apart` bytes behind the
/// first, as its sums lie `sums_apart` bytes behind those of the first.
///
/// # Safety
/// As for [`one`].
#[inline(always)]
unsafe fn four(operands: Operands, apart: usize, sums_apart: usize) {
    // SAFETY: as the caller promises.
    unsafe {
        asm!(
            "tilezero tmm0",
            "tilezero tmm1",
            "tilezero tmm2",
            "tilezero tmm3",
            "2:",
            "tileloadd tmm4, [{a0} + {row}*1]",
            "tileloadd tmm6, [{b0} + {row}*1]",
            "tileloadd tmm5, [{a1} + {row}*1]",
            "tileloadd tmm7, [{b1} + {row}*1]",
            "tdpbf16ps tmm0, tmm4, tmm6",
            "tdpbf16ps tmm1, tmm5, tmm6",
            "tdpbf16ps tmm2, tmm4, tmm7",
            "tdpbf16ps tmm3, tmm5, tmm7",
            "add {a0}, {a_step}",
            "add {a1}, {a_step}",
            "add {b0}, {b_step}",
            "add {b1}, {b_step}",
            "dec {steps}",
            "jnz 2b",
            "tilestored [{c0} + {row}*1], tmm0",
            "tilestored [{c1} + {row}*1], tmm1",
            "add {c0}, {sums_apart}",
            "add {c1}, {sums_apart}",
            "tilestored [{c0} + {row}*1], tmm2",
            "tilestored [{c1} + {row}*1], tmm3",
            a0 = inout(reg) operands.a[0] => _,
            a1 = inout(reg) operands.a[1] => _,
            b0 = inout(reg) operands.b => _,
            b1 = inout(reg) operands.b.byte_add(apart) => _,
            c0 = inout(reg) operands.c[0] => _,
            c1 = inout(reg) operands.c[1] => _,
            sums_apart = in(reg) sums_apart,
            row = in(reg) ROW,
            steps = inout(reg) operands.steps => _,
            a_step = in(reg) operands.a_step,
            b_step = in(reg) operands.b_step,
            out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
            out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
            options(nostack),
        );
    }
}

/// Tiles up to the last that so many rows or columns take, in all steps; none if there are more
/// than a number holds.
fn reach<const G: usize>(n: usize, steps: usize, [apart, step]: [usize; 2]) -> Option<usize> {
    let last = (n - 1).checked_mul(apart)?;
    last.checked_add((steps - 1).checked_mul(step)?)?
        .checked_add(G)
}

impl Tiles {
    /// Writes the products to tiles of sums `[column][row][irrep]`, or adds them to those. Several
    /// columns take an even number of rows, and do not add.
    #[inline(always)]
    pub fn multiply<const G: usize>(&self, factors: Factors, sums: &mut [Block<f32>], add: bool) {
        let Factors {
            a,
            rows,
            a_apart,
            b,
            columns,
            b_apart,
            steps,
        } = factors;
        assert!(steps > 0 && rows > 0 && columns > 0);
        assert!(columns == 1 || (rows.is_multiple_of(2) && !add));
        assert!(reach::<G>(rows, steps, a_apart).is_some_and(|tiles| tiles <= a.len() / TILE));
        assert!(reach::<G>(columns, steps, b_apart).is_some_and(|tiles| tiles <= b.len() / TILE));
        assert!(sums.len() / TILE / G / rows >= columns);
        let (a, b, c) = (a.as_ptr(), b.as_ptr(), sums.as_mut_ptr());
        for column in (0..columns).step_by(2) {
            for row in (0..rows).step_by(2) {
                let (two_rows, two_columns) = (row + 1 < rows, column + 1 < columns);
                for irrep in 0..G {
                    // SAFETY: the tiles are configured while `self` is there, and these are rows
                    // and columns that the assertions have found to lie in the slices. Where there
                    // is no second row, its pointers are those of the first.
                    unsafe {
                        let at = |column: usize| {
                            let next = row + usize::from(two_rows);
                            let first = (column * rows) * G + irrep;
                            Operands {
                                a: [row, next].map(|row| a.add((row * a_apart[0] + irrep) * TILE)),
                                b: b.add((column * b_apart[0] + irrep) * TILE),
                                c: [row, next].map(|row| c.add((first + row * G) * TILE)),
                                steps,
                                a_step: a_apart[1] * TILE_LEN,
                                b_step: b_apart[1] * TILE_LEN,
                            }
                        };
                        match (two_rows, two_columns) {
                            (true, true) => {
                                four(at(column), b_apart[0] * TILE_LEN, rows * G * TILE_LEN)
                            }
                            (true, false) => two(at(column), add),
                            (false, _) => one(at(column), add),
                        }
                    }
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
    /// `[block][row]`, whose words are pairs of blocks, to tiles `[16 rows][step][irrep]`, the first
    /// of which lie `apart` blocks apart.
    pack_rows(x: &[Block<f32>], rows: usize, apart: usize, to: &mut [Block<f32>]);
    /// One step of weights `[group][block]` that rows of folds meet, to tiles `[G blocks][irrep]`;
    /// `at` is the block of folds that each of the first 2 G stands for.
    pack_weights(w: &[Block<f32>], width: usize, at: [Option<usize>; 8], to: &mut [Block<f32>]);
    /// Weights of folds that rows of output gradients meet, to tiles `[step][irrep]`; `at` is the
    /// group of each column.
    pack_transposed(w: &[Block<f32>], width: usize, at: [Option<usize>; TILE], to: &mut [Block<f32>]);
    /// Folds `[fold][row]`, whose words are pairs of rows, to tiles `[step][irrep]`.
    pack_pairs(x: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Output gradients `[block][row]`, whose words are pairs of rows, one to a column, to tiles
    /// `[step][G blocks][irrep]`.
    pack_across(dy: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Sums `[G blocks][16 rows][irrep]` to rows `[row][block]`.
    unpack_rows(sums: &[Block<f32>], tiles: usize, rows: usize, to: &mut [Block<f32>]);
    /// Sums `[irrep]` to rows `[block][row]`.
    unpack_columns(sums: &[Block<f32>], rows: usize, to: &mut [Block<f32>]);
    /// Adds sums `[G blocks][irrep]`, whose rows are output fields, to gradients `[group][block]`;
    /// `at` is the group of each column.
    add_transposed(sums: &[Block<f32>], at: [Option<usize>; TILE], dw: &mut [Block<f32>], width: usize);
}

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
    let both = unsafe { std::mem::transmute::<__m512bh, __m512i>(both) };
    _mm512_permutexvar_epi16(pulp::cast(WORDS), both)
}

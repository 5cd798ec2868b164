//! How operands are packed into tiles, and sums brought back: safe functions of processors that have
//! AVX512-BF16.

#![forbid(unsafe_code)]

use std::arch::x86_64::{__m512i, _mm512_permutex2var_epi32, _mm512_setzero_si512};

use crate::simd::amx::{NONE, words};
use crate::simd::lanes::{Block, LANES, PAIRS, TILE};

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
    rows: usize,
    apart: usize,
    to: &mut [Block<f32>],
) {
    for (step, x) in x.chunks(2 * G * rows).enumerate() {
        for row in 0..rows {
            let mut v = [_mm512_setzero_si512(); G];
            for (v, pair) in v.iter_mut().zip(x.chunks(2 * rows)) {
                *v = words(&pair[row], pair.get(rows + row).unwrap_or(&NONE));
            }
            let at = row / TILE * apart + step * G * TILE + row % TILE;
            for (r, v) in transpose(v).into_iter().enumerate() {
                to[at + r * TILE] = pulp::cast(v);
            }
        }
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub fn pack_weights<const G: usize>(
    w: &[Block<f32>],
    width: usize,
    at: [Option<usize>; 8],
    to: &mut [Block<f32>],
) {
    let per_block = LANES / G;
    let block = |b: usize, q: usize, v: usize| match at[b] {
        Some(block) => &w[(block * per_block + q) * width + v],
        None => &NONE,
    };
    for pair in 0..G {
        for q in 0..per_block {
            for first in (0..width).step_by(G) {
                let mut v = [_mm512_setzero_si512(); G];
                for (v, i) in v.iter_mut().zip(first..width) {
                    *v = words(block(2 * pair, q, i), block(2 * pair + 1, q, i));
                }
                for (r, v) in transpose(v).into_iter().enumerate() {
                    to[(first + r) * TILE + q * G + pair] = pulp::cast(v);
                }
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
pub fn unpack_rows<const G: usize>(
    sums: &[Block<f32>],
    tiles: usize,
    rows: usize,
    to: &mut [Block<f32>],
) {
    let width = to.len() / rows;
    for (t, sums) in sums.chunks(tiles * G * TILE).enumerate() {
        for row in 0..rows {
            let sums = &sums[row / TILE * G * TILE..];
            let to = &mut to[row * width..][..width][t * G..];
            for (v, to) in of_irreps::<G>(sums, row % TILE).into_iter().zip(to) {
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

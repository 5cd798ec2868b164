//! The inner loops of the fold. Read this before editing: most of the time of a gather is spent here.
//!
//! A pair of taps carries a factor 1/sqrt2, and D2 pairs along both axes. The lines that runs read are
//! scaled by 1/2 where they are pairs themselves and by 1/sqrt2 where not, so that the many short runs are bare
//! sums and only a tap without a partner is scaled back by sqrt2. C1 has no pairs and no factors. Runs have one of a few constant lengths and are summed as arrays by value: written
//! as loops over slices they compile to scalar code, since the compiler must assume that the slices overlap.

use std::array::from_fn;
use std::ops::Range;

use crate::Scalar;
use crate::fold::{Matrices, Run, Target};

/// even = (a + b) / 2, odd = (a - b) / 2.
pub(crate) fn fold_lines<T: Scalar>(a: &[T], b: &[T], even: &mut [T], odd: &mut [T]) {
    let c = T::from_f64(0.5);
    for (((&a, &b), even), odd) in a.iter().zip(b).zip(even).zip(odd) {
        (*even, *odd) = ((a + b) * c, (a - b) * c);
    }
}

/// out += (even + sign odd) / 2.
pub(crate) fn unfold_lines<T: Scalar>(even: &[T], odd: &[T], sign: T, out: &mut [T]) {
    let (even_c, odd_c) = (T::from_f64(0.5), sign * T::from_f64(0.5));
    for ((&even, &odd), out) in even.iter().zip(odd).zip(out) {
        *out += even * even_c + odd * odd_c;
    }
}

/// out = scale line.
pub(crate) fn scaled<T: Scalar>(line: &[T], scale: T, out: &mut [T]) {
    for (out, &x) in out.iter_mut().zip(line) {
        *out = x * scale;
    }
}

/// The transpose of [`scaled`]: out += scale line.
pub(crate) fn add_scaled<T: Scalar>(line: &[T], scale: T, out: &mut [T]) {
    for (out, &x) in out.iter_mut().zip(line) {
        *out += x * scale;
    }
}

/// The output pixels of one line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixels {
    /// Their first row in the matrices.
    pub first: usize,
    /// Their number.
    pub count: usize,
    /// The distance in the line between the windows of neighbours.
    pub step: usize,
}

/// Cuts a run of channels into the lengths that [`fold`] and [`unfold`] know.
pub(crate) fn pieces(channels: Range<usize>) -> Vec<Range<usize>> {
    let mut start = channels.start;
    let mut pieces = Vec::new();
    while start < channels.end {
        let left = channels.end - start;
        let len = [16, 8, 6, 4, 2, 1].into_iter().find(|&len| len <= left);
        let end = start + len.unwrap_or(left);
        pieces.push(start..end);
        start = end;
    }
    pieces
}

/// Folds a run of the lines along x into rows of the matrices.
pub(crate) fn fold<T: Scalar>(run: &Run, lines: &[T], matrices: &mut Matrices<T>, pixels: Pixels) {
    match run.len {
        16 => fold_run::<T, 16>(run, lines, matrices, pixels),
        8 => fold_run::<T, 8>(run, lines, matrices, pixels),
        6 => fold_run::<T, 6>(run, lines, matrices, pixels),
        4 => fold_run::<T, 4>(run, lines, matrices, pixels),
        2 => fold_run::<T, 2>(run, lines, matrices, pixels),
        _ => fold_run::<T, 1>(run, lines, matrices, pixels),
    }
}

/// The transpose of [`fold`]: adds to the lines.
pub(crate) fn unfold<T: Scalar>(
    run: &Run,
    lines: &mut [T],
    matrices: &Matrices<T>,
    pixels: Pixels,
) {
    match run.len {
        16 => unfold_run::<T, 16>(run, lines, matrices, pixels),
        8 => unfold_run::<T, 8>(run, lines, matrices, pixels),
        6 => unfold_run::<T, 6>(run, lines, matrices, pixels),
        4 => unfold_run::<T, 4>(run, lines, matrices, pixels),
        2 => unfold_run::<T, 2>(run, lines, matrices, pixels),
        _ => unfold_run::<T, 1>(run, lines, matrices, pixels),
    }
}

fn fold_run<T: Scalar, const N: usize>(
    run: &Run,
    lines: &[T],
    matrices: &mut Matrices<T>,
    pixels: Pixels,
) {
    let left = lines[pixels.span(run.left, N)].chunks(pixels.step);
    let Some((right, odd)) = run.odd else {
        let evens = matrices[run.even.block][pixels.rows(run.even, N)].chunks_mut(run.even.stride);
        let c = T::from_f64(run.alone);
        for (a, even) in left.zip(evens) {
            *head_mut::<T, N>(even) = head::<T, N>(a).map(|a| a * c);
        }
        return;
    };
    let right = lines[pixels.span(right, N)].chunks(pixels.step);
    // the parts differ in parity, hence go to different matrices
    let Ok([evens, odds]) = matrices.get_disjoint_mut([run.even.block, odd.block]) else {
        unreachable!("even and odd parts belong to different output irreps")
    };
    let evens = evens[pixels.rows(run.even, N)].chunks_mut(run.even.stride);
    let odds = odds[pixels.rows(odd, N)].chunks_mut(odd.stride);
    for ((a, b), (even, odd)) in left.zip(right).zip(evens.zip(odds)) {
        let (a, b) = (head::<T, N>(a), head::<T, N>(b));
        *head_mut(even) = from_fn::<T, N, _>(|i| a[i] + b[i]);
        *head_mut(odd) = from_fn::<T, N, _>(|i| a[i] - b[i]);
    }
}

fn unfold_run<T: Scalar, const N: usize>(
    run: &Run,
    lines: &mut [T],
    matrices: &Matrices<T>,
    pixels: Pixels,
) {
    let evens = matrices[run.even.block][pixels.rows(run.even, N)].chunks(run.even.stride);
    let Some((right, odd)) = run.odd else {
        let c = T::from_f64(run.alone);
        let left = lines[pixels.span(run.left, N)].chunks_mut(pixels.step);
        for (a, even) in left.zip(evens) {
            let (a, even) = (head_mut::<T, N>(a), head::<T, N>(even));
            *a = from_fn(|i| a[i] + even[i] * c);
        }
        return;
    };
    let odds = matrices[odd.block][pixels.rows(odd, N)].chunks(odd.stride);
    let left = lines[pixels.span(run.left, N)].chunks_mut(pixels.step);
    for (a, (even, odd)) in left.zip(evens.clone().zip(odds.clone())) {
        let (a, even, odd) = (head_mut::<T, N>(a), head::<T, N>(even), head::<T, N>(odd));
        *a = from_fn(|i| a[i] + (even[i] + odd[i]));
    }
    let right = lines[pixels.span(right, N)].chunks_mut(pixels.step);
    for (b, (even, odd)) in right.zip(evens.zip(odds)) {
        let (b, even, odd) = (head_mut::<T, N>(b), head::<T, N>(even), head::<T, N>(odd));
        *b = from_fn(|i| b[i] + (even[i] - odd[i]));
    }
}

impl Pixels {
    /// From the run at `start` of the first pixel's window to that of the last.
    fn span(&self, start: usize, len: usize) -> Range<usize> {
        start..start + (self.count - 1) * self.step + len
    }

    /// From the run of the first row of a matrix to that of the last.
    fn rows(&self, target: Target, len: usize) -> Range<usize> {
        let start = self.first * target.stride + target.column;
        start..start + (self.count - 1) * target.stride + len
    }
}

/// The first N values by value; rows and windows are at least as long as the run they start with.
#[inline(always)]
fn head<T: Copy, const N: usize>(values: &[T]) -> [T; N] {
    match values.first_chunk() {
        Some(head) => *head,
        None => unreachable!("a run is no longer than its row"),
    }
}

#[inline(always)]
fn head_mut<T, const N: usize>(values: &mut [T]) -> &mut [T; N] {
    match values.first_chunk_mut() {
        Some(head) => head,
        None => unreachable!("a run is no longer than its row"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_consecutive_and_of_known_lengths() {
        assert_eq!(pieces(3..3), []);
        assert_eq!(pieces(5..12), [5..11, 11..12]);
        assert_eq!(pieces(2..49), [2..18, 18..34, 34..42, 42..48, 48..49]);
        for len in 1..100 {
            let lens: Vec<usize> = pieces(7..7 + len).iter().map(Range::len).collect();
            assert_eq!(lens.iter().sum::<usize>(), len);
            assert!(lens.iter().all(|len| [16, 8, 6, 4, 2, 1].contains(len)));
        }
    }
}

//! Convolutions of trivial channels under D2: first layers, whose images are large and whose
//! channels are few.
//!
//! They read lines that are folded along y (see [`Lines`]) where they lie, without panels of
//! patches. Columns t and k - 1 - t of a window share their weights up to the signs of the lanes.
//! So one sum goes over the columns of each half, a and b, and a + b and a - b are the two parities
//! along x. A mirrored image swaps a and b: the symmetry stays exact.

use std::ops::Range;

use symmetry::D2;

use crate::conv::finish::Finish;
use crate::conv::load::{Buffers, Loader, MOST};
use crate::conv::pass::{Backward, Forward};
use crate::conv::pieces::Pieces;
use crate::real::Real;
use crate::simd::columns::Columns;
use crate::simd::gather::narrow;
use crate::simd::join::head;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{G, Lines};
use crate::simd::patches::{Orbit, Patches};
use crate::simd::tiles::load_all;
use crate::window::Kernel;

/// Output pixels of a tile of a forward pass.
const TILE: usize = 8;
/// Numbers of channels for which the sums of a tile have code of their own: RGB, and RGB of two
/// frames.
const RGB: usize = 3;
const TWO_RGB: usize = 6;

impl<T: Real> Forward<'_, T> {
    /// The pass, from lines that are folded one line of output at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &Lines, x: &[T]) {
        let (conv, patches, weights) = (self.conv, &self.conv.patches, &self.conv.weights);
        let mut pieces = Pieces::new(self.scratch);
        let w = pieces.take(weights.blocks());
        weights.pack(self.params, w);
        scale(lanes, patches, w);
        let of_output = self.to.lines.clone();
        let mut finish =
            Finish::<T, L, G>::new(lanes, conv, self.params, &mut pieces, self.to, TILE);
        let sums = pieces.take(TILE * weights.width());
        let own = pieces.flat_zeros(lines.staged());
        let line = Line::new(lanes, patches, weights.width());
        for (i, (image, oy)) in lines_of(self.samples, of_output).enumerate() {
            let x = &x[image * patches.image().len()..][..patches.image().len()];
            lines.fold(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out.width).step_by(TILE) {
                let rows = TILE.min(conv.out.width - first);
                line.forward(&own[line.start(lines, first)..], w, sums, rows);
                finish.run(sums, i * conv.out.width + first, rows);
            }
        }
    }
}

impl<T: Real> Backward<'_, T> {
    /// The gradients of the parameters, from lines that are folded one line of output at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(mut self, lanes: L, lines: &Lines, x: &[T]) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut pieces = Pieces::new(std::mem::take(&mut self.scratch));
        let mut buffers = Buffers::new(&mut self, &mut pieces, MOST);
        let loader = Loader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        let width = conv.weights.width();
        let columns = pieces.zeros(lines.columns() * width);
        let own = pieces.flat_zeros(lines.staged());
        let line = Line::new(lanes, patches, width);
        for (image, oy) in lines_of(self.samples, 0..conv.out.height) {
            let x = &x[image * patches.image().len()..][..patches.image().len()];
            lines.fold(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out.width).step_by(MOST) {
                let count = MOST.min(conv.out.width - first);
                let row = (image * conv.out.height + oy) * conv.out.width + first;
                loader.run(row, count, &mut buffers);
                let dy = &buffers.dy[..count * width];
                line.weights(lines, &own[line.start(lines, first)..], dy, columns);
            }
        }
        line.fold(lines, columns, buffers.dw);
        buffers.finish::<G>(conv);
    }
}

/// These lines of output of every image.
fn lines_of(samples: usize, lines: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
    (0..samples).flat_map(move |image| lines.clone().map(move |oy| (image, oy)))
}

/// Brings the coefficients of the folds to the weights.
#[inline(always)]
fn scale<T: Real, L: Lanes<T>>(lanes: L, patches: &Patches, w: &mut [Block<T>]) {
    let per_group = w.len() / (patches.folded() * LANES / G);
    for orbit in &patches.orbits {
        let groups = orbit.first * LANES / G..(orbit.first + patches.blocks()) * LANES / G;
        let c = lanes.load(&narrow(&orbit.coefficients[0]));
        for w in &mut w[groups.start * per_group..groups.end * per_group] {
            lanes.store(w, lanes.mul(lanes.load(w), c));
        }
    }
}

/// The products of a line of output.
#[derive(Clone, Copy)]
struct Line<'a, T: Real, L: Lanes<T>> {
    lanes: L,
    patches: &'a Patches,
    channels: usize,
    /// Blocks of an output pixel.
    width: usize,
    /// From the window of an output pixel to the next.
    step: usize,
    /// The signs of the lanes under a flip of x.
    signs: L::V,
    /// Whether the windows are those of [`halving_tiles`](Line::halving_tiles).
    halves: bool,
}

impl<'a, T: Real, L: Lanes<T>> Line<'a, T, L> {
    #[inline(always)]
    fn new(lanes: L, patches: &'a Patches, width: usize) -> Self {
        let fields = patches.image().fields;
        let irreps = fields.group().irreps();
        let mut signs = [T::ZERO; LANES];
        for (lane, sign) in signs.iter_mut().enumerate() {
            *sign = T::from_f64(irreps[lane % irreps.len()].sign(D2::FlipX).into());
        }
        let Kernel { size, stride, .. } = patches.kernel();
        Line {
            lanes,
            patches,
            channels: fields.dim(),
            halves: size == 4 && stride == 2,
            width,
            step: patches.kernel().stride * fields.dim() * G,
            signs: lanes.load(&signs),
        }
    }

    /// Where the window of an output pixel starts.
    fn start(&self, lines: &Lines, ox: usize) -> usize {
        lines.shift() + ox * self.step
    }

    /// The sums `[pixel][block]` of the first `rows` of TILE pixels.
    #[inline(always)]
    fn forward(&self, x: &[T], w: &[Block<T>], sums: &mut [Block<T>], rows: usize) {
        let halves = L::REGISTERS >= 8 && rows == TILE && self.halves;
        match self.channels {
            RGB if halves => self.halving_tiles::<RGB>(x, w, sums),
            TWO_RGB if halves => self.halving_tiles::<TWO_RGB>(x, w, sums),
            _ => self.tiles(x, w, sums, rows),
        }
    }

    #[inline(always)]
    fn tiles(&self, x: &[T], w: &[Block<T>], sums: &mut [Block<T>], rows: usize) {
        let mut first = 0;
        while first < self.width {
            first += match (L::REGISTERS, rows, self.width - first) {
                (32.., TILE, 2..) => self.pixels::<4, 2>(x, w, first, rows, sums),
                (32.., TILE, _) => self.pixels::<TILE, 1>(x, w, first, rows, sums),
                (8..32, TILE, _) => self.pixels::<2, 1>(x, w, first, rows, sums),
                _ => self.pixels::<1, 1>(x, w, first, rows, sums),
            };
        }
    }

    /// V blocks of some pixels, R pixels at a time.
    #[inline(always)]
    fn pixels<const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        rows: usize,
        sums: &mut [Block<T>],
    ) -> usize {
        for row in (0..rows).step_by(R) {
            self.tile::<R, V>(x, w, first, row, sums);
        }
        V
    }

    /// The same for 4 x 4 windows of stride 2, two of which see every column, and C channels.
    #[inline(always)]
    fn halving_tiles<const C: usize>(&self, x: &[T], w: &[Block<T>], sums: &mut [Block<T>]) {
        let mut first = 0;
        while first < self.width {
            first += match (L::REGISTERS, self.width - first) {
                (32.., 2..) => self.halving_pixels::<C, 4, 2>(x, w, first, sums),
                (32.., _) => self.halving_pixels::<C, TILE, 1>(x, w, first, sums),
                _ => self.halving_pixels::<C, 2, 1>(x, w, first, sums),
            };
        }
    }

    /// V blocks of TILE pixels, R pixels at a time.
    #[inline(always)]
    fn halving_pixels<const C: usize, const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        sums: &mut [Block<T>],
    ) -> usize {
        for row in (0..TILE).step_by(R) {
            self.halving_tile::<C, R, V>(x, w, first, row, sums);
        }
        V
    }

    /// The sums of R pixels and V blocks.
    #[inline(always)]
    fn tile<const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        let lanes = self.lanes;
        let mut a = [[lanes.splat(T::ZERO); V]; R];
        let mut b = a;
        for orbit in &self.patches.orbits {
            let w = &w[orbit.first * (LANES / G) * self.width..][..self.channels * self.width];
            let left = self.columns::<R>(x, row, orbit.taps[0]);
            match orbit.taps.get(1) {
                Some(&tap) => {
                    let right = self.columns::<R>(x, row, tap);
                    for c in 0..self.channels {
                        let w: [L::V; V] = load_all(lanes, head(&w[c * self.width + first..]));
                        for r in 0..R {
                            let (left, right) = (lanes.quad(&left[r][c]), lanes.quad(&right[r][c]));
                            for v in 0..V {
                                a[r][v] = lanes.mul_add(left, w[v], a[r][v]);
                                b[r][v] = lanes.mul_add(right, w[v], b[r][v]);
                            }
                        }
                    }
                }
                None => {
                    for c in 0..self.channels {
                        let w: [L::V; V] = load_all(lanes, head(&w[c * self.width + first..]));
                        for r in 0..R {
                            let middle = lanes.quad(&left[r][c]);
                            for v in 0..V {
                                a[r][v] = lanes.mul_add(middle, w[v], a[r][v]);
                            }
                        }
                    }
                }
            }
        }
        self.combine(a, b, first, row, sums);
    }

    /// The same where two windows see every column: it is loaded once for both.
    #[inline(always)]
    fn halving_tile<const C: usize, const R: usize, const V: usize>(
        &self,
        x: &[T],
        w: &[Block<T>],
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        let lanes = self.lanes;
        let mut a = [[lanes.splat(T::ZERO); V]; R];
        let mut b = a;
        // the orbits of a line are that of the outer columns of a window and that of the inner ones
        for [outer, inner] in self.patches.orbits.as_chunks().0 {
            let of = |orbit: &Orbit| &w[orbit.first * (LANES / G) * self.width + first..];
            let (outer_w, inner_w) = (of(outer), of(inner));
            let x: &[[T; G]] = x[row * self.step + outer.taps[0]..].as_chunks().0;
            let x = &x[..(2 * R + 2) * C];
            for c in 0..C {
                let outer: [L::V; V] = load_all(lanes, head(&outer_w[c * self.width..]));
                let inner: [L::V; V] = load_all(lanes, head(&inner_w[c * self.width..]));
                let mut left = [lanes.quad(&x[c]), lanes.quad(&x[C + c])];
                for r in 0..R {
                    let right = [
                        lanes.quad(&x[(2 * r + 2) * C + c]),
                        lanes.quad(&x[(2 * r + 3) * C + c]),
                    ];
                    for v in 0..V {
                        a[r][v] = lanes.mul_add(left[0], outer[v], a[r][v]);
                        b[r][v] = lanes.mul_add(right[1], outer[v], b[r][v]);
                        a[r][v] = lanes.mul_add(left[1], inner[v], a[r][v]);
                        b[r][v] = lanes.mul_add(right[0], inner[v], b[r][v]);
                    }
                    left = right;
                }
            }
        }
        self.combine(a, b, first, row, sums);
    }

    /// Writes the sums over both halves of the windows.
    #[inline(always)]
    fn combine<const R: usize, const V: usize>(
        &self,
        a: [[L::V; V]; R],
        b: [[L::V; V]; R],
        first: usize,
        row: usize,
        sums: &mut [Block<T>],
    ) {
        for r in 0..R {
            for v in 0..V {
                let sum = self.lanes.mul_add(b[r][v], self.signs, a[r][v]);
                let to = &mut sums[(row + r) * self.width + first + v];
                self.lanes.store(to, sum);
            }
        }
    }

    /// The channels that R neighbouring windows see through a tap.
    #[inline(always)]
    fn columns<'x, const R: usize>(&self, x: &'x [T], row: usize, tap: usize) -> [&'x [[T; G]]; R] {
        let mut columns: [&[[T; G]]; R] = [&[]; R];
        for (r, column) in columns.iter_mut().enumerate() {
            let at = (row + r) * self.step + tap;
            *column = &x[at..].as_chunks().0[..self.channels];
        }
        columns
    }

    /// Adds x^T dy of neighbouring pixels, for every column of the lines by itself: dy
    /// `[block][pixel]`, dw `[column][block]`.
    #[inline(always)]
    fn weights(&self, lines: &Lines, x: &[T], dy: &[Block<T>], dw: &mut [Block<T>]) {
        let columns = lines.columns() / lines.each();
        for i in 0..lines.each() {
            let x = &x[lines.offset(i)..];
            let dw = &mut dw[i * columns * self.width..][..columns * self.width];
            let mut first = 0;
            while first < self.width {
                let tile = Columns {
                    lanes: self.lanes,
                    width: self.width,
                    step: self.step,
                    x,
                    dy,
                    first,
                };
                first += match (L::REGISTERS, self.width - first) {
                    (32.., 2..) => tile.all::<6, 2>(columns, dw),
                    (32.., _) => tile.all::<12, 1>(columns, dw),
                    (8..32, _) => tile.all::<6, 1>(columns, dw),
                    _ => tile.all::<4, 1>(columns, dw),
                };
            }
        }
    }

    /// Adds up what both halves of the windows say of the weights they share.
    #[inline(always)]
    fn fold(&self, lines: &Lines, columns: &[Block<T>], dw: &mut [Block<T>]) {
        let lanes = self.lanes;
        let len = self.channels * self.width;
        for orbit in &self.patches.orbits {
            let dw = &mut dw[orbit.first * (LANES / G) * self.width..][..len];
            for (x, coefficients) in halves(lines, orbit).zip(&orbit.coefficients) {
                let c = lanes.load(&narrow(coefficients));
                for (d, part) in dw.iter_mut().zip(&columns[x * len..][..len]) {
                    lanes.store(d, lanes.mul_add(lanes.load(part), c, lanes.load(d)));
                }
            }
        }
    }
}

/// The columns of the lines that an orbit meets.
fn halves(lines: &Lines, orbit: &Orbit) -> impl Iterator<Item = usize> {
    let [y, x] = orbit.start;
    let k = lines.size();
    [y * k + x, y * k + k - 1 - x]
        .into_iter()
        .take(orbit.taps.len())
}

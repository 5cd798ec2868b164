//! Convolutions of trivial channels under D2: first layers, whose images are large and whose
//! channels are few.
//!
//! They read lines that are folded along y (see [`Lines`]) where they lie, without panels of
//! patches. Columns t and k - 1 - t of a window share their weights up to the signs of the lanes.
//! So one sum goes over the columns of each half, a and b, and a + b and a - b are the two parities
//! along x, to which the middle column of an odd window is added last. A mirrored image swaps a and
//! b: the symmetry stays exact.

use std::ops::Range;

use crate::conv::epilogue::Epilogue;
use crate::conv::gradient_loader::{Buffers, Loader, MOST};
use crate::conv::line::{Line, TILE};
use crate::conv::maps::{Input, Pieces};
use crate::conv::operands::{Backward, Forward};
use crate::real::Real;
use crate::simd::gather::narrow;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{G, Lines, Pixel};
use crate::simd::patches::Patches;

impl<T: Real> Forward<'_, T> {
    /// The pass, from lines that are folded one line of output at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &Lines) {
        match self.x {
            Input::Channels(x) => self.run_pixels(lanes, lines, x),
            Input::Bytes(x) => self.run_pixels(lanes, lines, x),
            Input::Staged(_) => unreachable!("a chain hands no trivial channels on"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(self, lanes: L, lines: &Lines, x: &[P]) {
        let (conv, patches, weights) = (self.conv, &self.conv.patches, &self.conv.weights);
        let mut pieces = Pieces::new(self.scratch);
        let w = pieces.take(weights.blocks());
        weights.pack(self.params, w);
        scale(lanes, patches, w);
        let of_output = self.to.lines.clone();
        let mut epilogue = Epilogue::<T, L, G>::new(lanes, conv, self.params, &mut pieces, self.to);
        let sums = pieces.take(TILE * weights.width());
        let own = pieces.flat_zeros(lines.staged());
        let line = Line::new(lanes, patches, weights.width());
        let len = patches.image().len();
        for (i, (image, oy)) in lines_of(self.samples, of_output).enumerate() {
            let x = &x[image * len..][..len];
            lines.fold(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out.width).step_by(TILE) {
                let rows = TILE.min(conv.out.width - first);
                line.forward(&own[line.start(lines, first)..], w, sums, rows);
                epilogue.run(sums, i * conv.out.width + first, rows);
            }
        }
    }
}

impl<T: Real> Backward<'_, T> {
    /// The gradients of the parameters, from lines that are folded one line of output at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &Lines) {
        match self.x {
            Input::Channels(x) => self.run_pixels(lanes, lines, x),
            Input::Bytes(x) => self.run_pixels(lanes, lines, x),
            Input::Staged(_) => unreachable!("a chain hands no trivial channels on"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(mut self, lanes: L, lines: &Lines, x: &[P]) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut pieces = Pieces::new(std::mem::take(&mut self.scratch));
        let mut buffers = Buffers::new(&mut self, &mut pieces, MOST);
        let loader = Loader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        let width = conv.weights.width();
        let columns = pieces.zeros(lines.columns() * width);
        let own = pieces.flat_zeros(lines.staged());
        let line = Line::new(lanes, patches, width);
        let len = patches.image().len();
        for (image, oy) in lines_of(self.samples, 0..conv.out.height) {
            let x = &x[image * len..][..len];
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

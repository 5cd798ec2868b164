//! Convolutions of trivial channels under D2: first layers, with large images and few channels.
//!
//! They read lines folded along y (see [`Lines`]) in place, without panels of patches. Columns t
//! and k - 1 - t of a window share their weights up to the signs of the lanes. So one sum, a, goes
//! over the columns of the left half and one, b, over those of the right half; a + b and a - b are
//! the two parities along x. The middle column of an odd window is added last. A mirrored image
//! swaps a and b, so the symmetry stays exact.

use std::ops::Range;

use crate::conv::epilogue::Epilogue;
use crate::conv::gradient_loader::{Buffers, Loader, MAX_ROWS};
use crate::conv::line::{Line, TILE};
use crate::conv::maps::{Arena, Input};
use crate::conv::operands::{Backward, Forward};
use crate::real::Real;
use crate::simd::gather::narrow;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{G, Lines, Pixel};
use crate::simd::patches::Patches;

impl<T: Real> Forward<'_, T> {
    /// Runs the pass on lines that are folded for one line of output pixels at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &Lines) {
        match self.x {
            Input::Channels(x) => self.run_pixels(lanes, lines, x),
            Input::Bytes(x) => self.run_pixels(lanes, lines, x),
            Input::Staged(_) => unreachable!("a chain stages no trivial channels"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(self, lanes: L, lines: &Lines, x: &[P]) {
        let (conv, patches, weights) = (self.conv, &self.conv.patches, &self.conv.weights);
        let mut arena = Arena::new(self.scratch);
        let w = arena.take(weights.blocks());
        weights.pack(self.params, w);
        scale(lanes, patches, w);
        let of_output = self.to.lines.clone();
        let mut epilogue = Epilogue::<T, L, G>::new(lanes, conv, self.params, &mut arena, self.to);
        let sums = arena.take(TILE * weights.width());
        let own = arena.flat_zeros(lines.staged());
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
    /// Runs the pass for the parameters only, on lines that are folded for one line of output at a
    /// time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &Lines) {
        match self.x {
            Input::Channels(x) => self.run_pixels(lanes, lines, x),
            Input::Bytes(x) => self.run_pixels(lanes, lines, x),
            Input::Staged(_) => unreachable!("a chain stages no trivial channels"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(mut self, lanes: L, lines: &Lines, x: &[P]) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut arena = Arena::new(std::mem::take(&mut self.scratch));
        let mut buffers = Buffers::new(&mut self, &mut arena, MAX_ROWS);
        let loader = Loader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        let width = conv.weights.width();
        let columns = arena.zeros(lines.columns() * width);
        let own = arena.flat_zeros(lines.staged());
        let line = Line::new(lanes, patches, width);
        let len = patches.image().len();
        for (image, oy) in lines_of(self.samples, 0..conv.out.height) {
            let x = &x[image * len..][..len];
            lines.fold(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out.width).step_by(MAX_ROWS) {
                let count = MAX_ROWS.min(conv.out.width - first);
                let row = (image * conv.out.height + oy) * conv.out.width + first;
                loader.run(row, count, &mut buffers);
                let dy = &buffers.dy[..count * width];
                line.weights(lines, &own[line.start(lines, first)..], dy, columns);
            }
        }
        // gradients are summed for every column first and folded once at the end
        line.fold(lines, columns, buffers.dw);
        buffers.finish::<G>(conv);
    }
}

/// Iterates over `(image, line)` for these lines of output pixels of every image.
fn lines_of(samples: usize, lines: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
    (0..samples).flat_map(move |image| lines.clone().map(move |oy| (image, oy)))
}

/// Multiplies the weights by the coefficients of the folds, which the folded lines leave out.
#[inline(always)]
fn scale<T: Real, L: Lanes<T>>(lanes: L, patches: &Patches, w: &mut [Block<T>]) {
    let per_group = w.len() / (patches.folded() * LANES / G);
    for orbit in &patches.orbits {
        let groups = orbit.first * LANES / G..(orbit.first + patches.blocks()) * LANES / G;
        let c = lanes.load(&narrow(&orbit.coefficients[0]));
        for block in &mut w[groups.start * per_group..groups.end * per_group] {
            lanes.store(block, lanes.mul(lanes.load(block), c));
        }
    }
}

//! Convolutions of trivial channels under D2: first layers, with large images and few channels.
//!
//! They read lines folded along y (see [`FoldedLines`]) in place, without panels of patches.
//! Columns t and k - 1 - t of a window share their weights up to the signs of the lanes. So one
//! sum, a, goes over the columns of the left half and one, b, over those of the right half; a + b
//! and a - b are the two parities along x. The middle column of an odd window is added last. A
//! mirrored image swaps a and b, so the symmetry stays exact.

use std::ops::Range;

use crate::conv::epilogue::Epilogue;
use crate::conv::gradient_loader::{ConvGradientScratch, GradientLoader, MAX_GRADIENT_ROWS};
use crate::conv::line::{LINE_TILE_PIXELS, LineKernel};
use crate::conv::maps::{Arena, ConvInput};
use crate::conv::operands::{ConvBackwardOperands, ConvForwardOperands};
use crate::real::Real;
use crate::simd::gather::block_to_precision;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::{FoldedLines, LANES_PER_GROUP, Pixel};
use crate::simd::patches::PatchGeometry;

impl<T: Real> ConvForwardOperands<'_, T> {
    /// Runs the forward pass of a convolution of trivial channels under D2, folding the image rows
    /// for one line of output pixels at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &FoldedLines) {
        match self.x {
            ConvInput::Channels(x) => self.run_pixels(lanes, lines, x),
            ConvInput::Bytes(x) => self.run_pixels(lanes, lines, x),
            ConvInput::Blocked(_) => unreachable!("a chain stages no trivial channels"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(self, lanes: L, lines: &FoldedLines, x: &[P]) {
        let (conv, patches, weights) = (self.conv, &self.conv.patches, &self.conv.weights);
        let mut arena = Arena::new(self.scratch);
        let w = arena.take_blocks(weights.num_packed_blocks());
        weights.pack_weights(self.params, w);
        scale_weights(lanes, patches, w);
        let of_output = self.output.lines.clone();
        let mut epilogue = Epilogue::<T, L, LANES_PER_GROUP>::new(
            lanes,
            conv,
            self.params,
            &mut arena,
            self.output,
        );
        let sums = arena.take_blocks(LINE_TILE_PIXELS * weights.blocks_per_pixel);
        let own = arena.take_zeroed_values(lines.blocked_len());
        let line = LineKernel::new(lanes, patches, weights.blocks_per_pixel);
        let len = patches.image_shape.len();
        for (i, (image, oy)) in lines_of(self.samples, of_output).enumerate() {
            let x = &x[image * len..][..len];
            lines.fold_image(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out_shape.width).step_by(LINE_TILE_PIXELS) {
                let rows = LINE_TILE_PIXELS.min(conv.out_shape.width - first);
                line.write_weighted_sums(&own[line.window_start(lines, first)..], w, sums, rows);
                epilogue.write_outputs(sums, i * conv.out_shape.width + first, rows);
            }
        }
    }
}

impl<T: Real> ConvBackwardOperands<'_, T> {
    /// Adds the parameter gradients of a convolution of trivial channels under D2, folding the
    /// image rows for one line of output pixels at a time.
    #[inline(always)]
    pub(crate) fn run_lines<L: Lanes<T>>(self, lanes: L, lines: &FoldedLines) {
        match self.x {
            ConvInput::Channels(x) => self.run_pixels(lanes, lines, x),
            ConvInput::Bytes(x) => self.run_pixels(lanes, lines, x),
            ConvInput::Blocked(_) => unreachable!("a chain stages no trivial channels"),
        }
    }

    #[inline(always)]
    fn run_pixels<L: Lanes<T>, P: Pixel<T>>(mut self, lanes: L, lines: &FoldedLines, x: &[P]) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut arena = Arena::new(std::mem::take(&mut self.scratch));
        let mut buffers = ConvGradientScratch::new(&mut self, &mut arena, MAX_GRADIENT_ROWS);
        let loader = GradientLoader::<T, L, LANES_PER_GROUP>::new(lanes, conv, self.dy, self.masks);
        let width = conv.weights.blocks_per_pixel;
        let columns = arena.take_zeroed_blocks(lines.columns_per_window() * width);
        let own = arena.take_zeroed_values(lines.blocked_len());
        let line = LineKernel::new(lanes, patches, width);
        let len = patches.image_shape.len();
        for (image, oy) in lines_of(self.samples, 0..conv.out_shape.height) {
            let x = &x[image * len..][..len];
            lines.fold_image(lanes, x, oy..oy + 1, own);
            for first in (0..conv.out_shape.width).step_by(MAX_GRADIENT_ROWS) {
                let count = MAX_GRADIENT_ROWS.min(conv.out_shape.width - first);
                let row = (image * conv.out_shape.height + oy) * conv.out_shape.width + first;
                loader.load_output_gradients(row, count, &mut buffers);
                let dy = &buffers.dy[..count * width];
                line.add_column_gradients(
                    lines,
                    &own[line.window_start(lines, first)..],
                    dy,
                    columns,
                );
            }
        }
        // gradients are summed for every column first and folded once at the end
        line.fold_column_gradients(lines, columns, buffers.dw);
        buffers.add_to_param_gradients::<LANES_PER_GROUP>(conv);
    }
}

/// Iterates over `(image, line)` for the lines `lines` of output pixels of every image.
fn lines_of(samples: usize, lines: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
    (0..samples).flat_map(move |image| lines.clone().map(move |oy| (image, oy)))
}

/// Multiplies the packed weights by the coefficients of the tap functions, which the folded image
/// rows leave out.
#[inline(always)]
fn scale_weights<T: Real, L: Lanes<T>>(lanes: L, patches: &PatchGeometry, w: &mut [Block<T>]) {
    let per_group = w.len() / (patches.blocks_per_folded_patch * LANES / LANES_PER_GROUP);
    for orbit in &patches.orbits {
        let groups = orbit.first_block * LANES / LANES_PER_GROUP
            ..(orbit.first_block + patches.blocks_per_pixel) * LANES / LANES_PER_GROUP;
        let c = lanes.load(&block_to_precision(&orbit.coefficients[0]));
        for block in &mut w[groups.start * per_group..groups.end * per_group] {
            lanes.store(block, lanes.mul(lanes.load(block), c));
        }
    }
}

//! Forward pass of a convolution over panels (im2col matrices) of folded patches.

use crate::conv::epilogue::Epilogue;
use crate::conv::maps::{Arena, ConvInput, PixelCursor};
use crate::conv::operands::ConvForwardOperands;
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::gather::OrbitBlock;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::FoldedLines;
use crate::simd::patches::PatchGeometry;
use crate::simd::tiles::{PANEL_ROWS, panel_product};

/// Maximum number of output pixels for which the forward pass of a convolution reads parameters in
/// place. With more pixels it pays to copy the parameters to aligned memory first.
const MAX_ROWS_IN_PLACE: usize = 2 * PANEL_ROWS;

/// Returns the length of the scratch memory of a forward pass, in values, also for two halves of a
/// single image; `is_blocked` is `true` if the input is in the blocked layout already.
pub(crate) fn scratch_len(conv: &R2Conv, samples: usize, is_blocked: bool) -> usize {
    let (patches, weights) = (&conv.patches, &conv.weights);
    let per_row = patches.blocks_per_folded_patch + weights.blocks_per_pixel;
    let rest = weights.num_packed_blocks()
        + (PANEL_ROWS + 1) * weights.blocks_per_pixel
        + PANEL_ROWS * per_row;
    let line = patches.folded_lines.as_ref().map_or(0, FoldedLines::blocked_len);
    let with = |images| rest * LANES + images * patches.blocked_len() + line;
    // two halves of a single image run at the same time, each on its half of the scratch
    if is_blocked {
        2 * with(0)
    } else {
        with(conv.num_images_converted_at_once(samples)).max(2 * with(1))
    }
}

impl<'a, T: Real> ConvForwardOperands<'a, T> {
    /// Runs the forward pass of a convolution over im2col panels of folded patches, for a group of
    /// `G` elements.
    #[inline(always)]
    pub(crate) fn run_panels<L: Lanes<T>, const G: usize>(self, lanes: L) {
        let (conv, patches, weights) = (self.conv, &self.conv.patches, &self.conv.weights);
        let mut arena = Arena::new(self.scratch);
        let (width, lines) = (conv.out_shape.width, &self.output.lines);
        let windows = &patches.window_starts[lines.start * width..lines.end * width];
        let few = self.samples * windows.len() <= MAX_ROWS_IN_PLACE;
        let mut panels = ForwardPanels::<T, L, G> {
            lanes,
            patches,
            windows,
            w: weights.packed_weights(self.params, &mut arena, few),
            panel: arena.take_blocks(PANEL_ROWS * patches.blocks_per_folded_patch),
            epilogue: Epilogue::new(lanes, conv, self.params, &mut arena, self.output),
            sums: arena.take_blocks(PANEL_ROWS * weights.blocks_per_pixel),
        };
        let (together, own) = match self.x {
            ConvInput::Channels(_) | ConvInput::Bytes(_) => {
                let together = conv.num_images_converted_at_once(self.samples);
                (together, arena.take_zeroed_values(patches.blocked_len() * together))
            }
            ConvInput::Blocked(_) => (self.samples.max(1), Default::default()),
        };
        for first in (0..self.samples).step_by(together) {
            let images = together.min(self.samples - first);
            let blocked = self.x.blocked_images(lanes, patches, first..first + images, own);
            panels.run(blocked, first, images);
        }
    }
}

/// Matrix products of im2col panels of folded patches with the weights of a convolution.
struct ForwardPanels<'a, T, L, const G: usize> {
    lanes: L,
    patches: &'a PatchGeometry,
    /// Start of the window of every output pixel in a blocked image.
    windows: &'a [usize],
    w: &'a [Block<T>],
    /// Im2col panel: folded patches (signed sums over orbits of taps) of [`PANEL_ROWS`] output
    /// pixels, `[block][pixel]`.
    panel: &'a mut [Block<T>],
    epilogue: Epilogue<'a, T, L, G>,
    /// Weighted sums `[pixel][block]` of [`PANEL_ROWS`] output pixels, before bias and ReLU.
    sums: &'a mut [Block<T>],
}

impl<T: Real, L: Lanes<T>, const G: usize> ForwardPanels<'_, T, L, G> {
    /// Computes the output for images in the blocked layout, the first of which is image
    /// `first` of the pass.
    #[inline(always)]
    fn run(&mut self, blocked: &[T], first: usize, images: usize) {
        let pixels = self.windows.len();
        let rows = images * pixels;
        let mut cursor = PixelCursor::new(pixels);
        for row in (0..rows).step_by(PANEL_ROWS) {
            let count = PANEL_ROWS.min(rows - row);
            let mut windows = [0; PANEL_ROWS];
            for (r, window) in windows.iter_mut().enumerate() {
                // pads an incomplete panel with copies of its last row, so that tiles have a fixed
                // size
                *window = cursor.blocked_index(self.windows, self.patches.blocked_len());
                if r + 1 < count {
                    cursor.advance();
                }
            }
            cursor.advance();
            self.gather(blocked, &windows);
            let panel = self.panel.as_chunks().0;
            panel_product::<T, L, G>(self.lanes, panel, self.w, self.sums, count);
            self.epilogue.write_outputs(self.sums, first * pixels + row, count);
        }
    }

    /// Fills the im2col panel with the folded patches of [`PANEL_ROWS`] windows.
    #[inline(always)]
    fn gather(&mut self, blocked: &[T], windows: &[usize]) {
        let patches = self.patches;
        let step = patches.blocks_per_pixel * PANEL_ROWS;
        for c in 0..patches.blocks_per_pixel {
            // Each orbit reads the same block of channels, which then comes from the first-level
            // cache.
            for orbit in 0..patches.orbits.len() {
                let first = patches.orbit_blocks(orbit).start + c;
                let panel = &mut self.panel[first * PANEL_ROWS..];
                let fold = OrbitBlock { orbit, block: c };
                patches.gather_signed_tap_sums(self.lanes, fold, blocked, windows, panel, step);
            }
        }
    }
}

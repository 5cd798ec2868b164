//! Backward pass of a convolution over panels (im2col matrices) of folded patches.

use std::ops::Range;

use crate::conv::gradient_loader::{ConvGradientScratch, GradientLoader};
use crate::conv::maps::{Arena, ConvInput, FeatureMapsMut, PixelCursor};
use crate::conv::operands::ConvBackwardOperands;
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::gather::OrbitBlock;
use crate::simd::lanes::{Block, LANES, Lanes};
use crate::simd::lines::FoldedLines;
use crate::simd::patches::PatchGeometry;
use crate::simd::tiles::{add_weight_gradient, fold_gradients};

/// Number of output pixels of an im2col panel in the backward pass of a convolution.
const ROWS: usize = 48;

/// Number of output pixels whose input gradient is summed at once: 6 pixels of 4 folds (signed sums
/// of taps) are 24 sums, which leaves registers for operands if there are 32.
const TILE: usize = 6;

/// Returns the length of the scratch memory of a backward pass, in values; `is_blocked` is `true`
/// if the input is in the blocked layout already.
pub(crate) fn scratch_len(conv: &R2Conv, samples: usize, is_blocked: bool) -> usize {
    let (patches, width) = (&conv.patches, conv.weights.blocks_per_pixel);
    // an input of channels is converted here, and so is the gradient with respect to it
    let images = if is_blocked { 0 } else { 2 * conv.num_images_converted_at_once(samples) };
    let of_lines =
        |lines: &FoldedLines| lines.blocked_len() + lines.columns_per_window() * width * LANES;
    let line = patches.folded_lines.as_ref().map_or(0, of_lines);
    ConvGradientScratch::<f32>::scratch_len(conv) + images * patches.blocked_len() + line
}

impl<'a, T: Real> ConvBackwardOperands<'a, T> {
    /// Adds a convolution's parameter gradients and, if it is needed, writes the input's gradient,
    /// by im2col panels of folded patches (signed sums over orbits of taps), for a group of `G`
    /// elements.
    #[inline(always)]
    pub(crate) fn run_panels<L: Lanes<T>, const G: usize>(mut self, lanes: L) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        let mut arena = Arena::new(std::mem::take(&mut self.scratch));
        let products = GradientProducts::<T, L, G>::new(lanes, &self, &mut arena);
        let mut buffers = ConvGradientScratch::new(&mut self, &mut arena, ROWS);
        let loader = GradientLoader::<T, L, G>::new(lanes, conv, self.dy, self.masks);
        // images in another layout are converted here, a few at a time
        let (together, own, own_gradient) = match self.x {
            ConvInput::Channels(_) | ConvInput::Bytes(_) => {
                let together = conv.num_images_converted_at_once(self.samples);
                let len = patches.blocked_len() * together;
                (together, arena.take_zeroed_values(len), arena.take_values(len))
            }
            ConvInput::Blocked(_) => (self.samples.max(1), Default::default(), Default::default()),
        };
        for first in (0..self.samples).step_by(together) {
            let images = together.min(self.samples - first);
            let blocked = self.x.blocked_images(lanes, patches, first..first + images, own);
            let gradient = match &mut self.dx {
                None => None,
                Some(FeatureMapsMut::Channels(_)) => Some(&mut *own_gradient),
                Some(FeatureMapsMut::Blocked(_, dx)) => Some(&mut **dx),
            };
            let panels = BackwardPanels { lanes, conv, blocked, images: first..first + images };
            panels.run(&loader, &products, &mut buffers, gradient);
            if let Some(FeatureMapsMut::Channels(dx)) = &mut self.dx {
                read_blocked(
                    patches,
                    own_gradient,
                    &mut dx[first * patches.image_shape.len()..],
                    images,
                );
            }
        }
        buffers.add_to_param_gradients::<G>(conv);
    }
}

/// Converts images from the blocked layout to channels `[H, W, C]`.
#[inline(always)]
fn read_blocked<T: Real>(patches: &PatchGeometry, blocked: &[T], dx: &mut [T], images: usize) {
    let blocked = blocked.chunks_exact(patches.blocked_len());
    let dx = dx.chunks_exact_mut(patches.image_shape.len());
    for (blocked_image, image_gradient) in blocked.zip(dx).take(images) {
        patches.read_blocked_gradient(blocked_image, image_gradient);
    }
}

/// Source of the im2col panels of a backward pass: images in the blocked layout.
struct BackwardPanels<'a, T, L> {
    lanes: L,
    conv: &'a R2Conv,
    blocked: &'a [T],
    /// Range of the blocked images among all images of the backward pass.
    images: Range<usize>,
}

impl<T: Real, L: Lanes<T>> BackwardPanels<'_, T, L> {
    /// Adds the contributions of the blocked images to the parameter gradients and overwrites
    /// `gradient`, the gradient with respect to the images.
    #[inline(always)]
    fn run<const G: usize>(
        &self,
        loader: &GradientLoader<T, L, G>,
        products: &GradientProducts<T, L, G>,
        buffers: &mut ConvGradientScratch<T>,
        mut gradient: Option<&mut [T]>,
    ) {
        let (patches, pixels) = (&self.conv.patches, loader.pixels_per_image);
        if let Some(gradient) = gradient.as_deref_mut() {
            gradient.fill(T::ZERO);
        }
        let mut cursor = PixelCursor::new(pixels);
        let end = self.images.end * pixels;
        for row in (self.images.start * pixels..end).step_by(ROWS) {
            let count = ROWS.min(end - row);
            let mut windows = [0; ROWS];
            for window in &mut windows[..count] {
                *window = cursor.blocked_index(&patches.window_starts, patches.blocked_len());
                cursor.advance();
            }
            loader.load_output_gradients(row, count, buffers);
            self.add_gradients(&windows[..count], products, buffers, gradient.as_deref_mut());
        }
    }

    /// Adds the contributions of the output pixels whose windows start at `windows` to the
    /// gradients.
    #[inline(always)]
    fn add_gradients<const G: usize>(
        &self,
        windows: &[usize],
        products: &GradientProducts<T, L, G>,
        buffers: &mut ConvGradientScratch<T>,
        mut gradient: Option<&mut [T]>,
    ) {
        let (conv, patches) = (self.conv, &self.conv.patches);
        for c in 0..patches.blocks_per_pixel {
            // Each orbit reads the same block of channels, which then comes from the first-level
            // cache.
            for orbit in 0..patches.orbits.len() {
                let rows = FoldedOrbit { conv, orbit, c, windows };
                let panel = &mut buffers.panel[..rows.num_folds() * windows.len()];
                let step = windows.len();
                let fold = OrbitBlock { orbit, block: c };
                patches.gather_signed_tap_sums(
                    self.lanes,
                    fold,
                    self.blocked,
                    windows,
                    panel,
                    step,
                );
                products.add_weight_gradient(&rows, buffers);
                if let Some(gradient) = gradient.as_deref_mut() {
                    products.add_input_gradient(&rows, buffers, gradient);
                }
            }
        }
    }
}

/// Folds (signed sums) of one orbit of taps in one block of channels, for the windows of some
/// output pixels.
struct FoldedOrbit<'a> {
    pub conv: &'a R2Conv,
    pub orbit: usize,
    pub c: usize,
    pub windows: &'a [usize],
}

impl FoldedOrbit<'_> {
    /// Returns the number of folds of the orbit of taps: one for each parity, or 1 if the parities
    /// share a block.
    #[inline(always)]
    pub fn num_folds(&self) -> usize {
        let patches = &self.conv.patches;
        patches.orbit_blocks(self.orbit).len() / patches.blocks_per_pixel
    }
}

/// Operands of the matrix products of a convolution's backward pass.
struct GradientProducts<'a, T, L, const G: usize> {
    lanes: L,
    /// Weights transposed for the input gradient; unset if the gradient with respect to the input
    /// is not needed.
    transposed_weights: &'a [Block<T>],
}

impl<'a, T: Real, L: Lanes<T>, const G: usize> GradientProducts<'a, T, L, G> {
    #[inline(always)]
    fn new(lanes: L, pass: &ConvBackwardOperands<'a, T>, arena: &mut Arena<'a, T>) -> Self {
        let (conv, layout) = (pass.conv, &pass.conv.weights);
        let w = arena.take_blocks(layout.num_packed_blocks());
        if pass.dx.is_some() {
            let packed = layout.packed_weights(pass.params, arena, true);
            layout.transpose_packed_weights::<T, G>(&conv.patches, packed, w);
        }
        GradientProducts { lanes, transposed_weights: w }
    }

    /// Adds the contribution of some output pixels to the weight gradient; the im2col panel is
    /// `[fold][output pixel]`.
    #[inline(always)]
    fn add_weight_gradient(&self, of: &FoldedOrbit, buffers: &mut ConvGradientScratch<T>) {
        let (patches, width) = (&of.conv.patches, of.conv.weights.blocks_per_pixel);
        let rows = of.windows.len();
        let per_block = LANES / G * width;
        let panel = &buffers.panel[..of.num_folds() * rows];
        let dy = &buffers.dy[..width * rows];
        let first = patches.orbit_blocks(of.orbit).start + of.c;
        let dw = &mut buffers.dw[first * per_block..];
        add_weight_gradient::<T, L, G>(
            self.lanes,
            panel,
            dy,
            rows,
            dw,
            patches.blocks_per_pixel * per_block,
        );
    }

    /// Adds the contribution of some output pixels to the gradient with respect to the input, in
    /// the blocked layout.
    #[inline(always)]
    fn add_input_gradient(
        &self,
        of: &FoldedOrbit,
        buffers: &mut ConvGradientScratch<T>,
        gradient: &mut [T],
    ) {
        let (patches, width) = (&of.conv.patches, of.conv.weights.blocks_per_pixel);
        let (folds, per_block) = (of.num_folds(), LANES / G * width);
        let dy = &buffers.dy[..width * of.windows.len()];
        let w = &self.transposed_weights[patches.orbit_blocks(of.orbit).start * per_block..];
        let w = &w[of.c * folds * per_block..][..folds * per_block];
        // orbits of D2 have 1, 2 or 4 taps, so these are all sizes of the product
        match (patches.is_replicated, folds) {
            (true, _) => of.replicated::<T, L, G>(self.lanes, w, dy, gradient),
            (false, 1) => of.add_input_gradient::<T, L, G, 1>(self.lanes, w, dy, gradient),
            (false, 2) => of.add_input_gradient::<T, L, G, 2>(self.lanes, w, dy, gradient),
            (false, _) => of.add_input_gradient::<T, L, G, 4>(self.lanes, w, dy, gradient),
        }
    }
}

impl FoldedOrbit<'_> {
    #[inline(always)]
    fn add_input_gradient<T: Real, L: Lanes<T>, const G: usize, const N: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let mut row = 0;
        // large tiles need many registers; instruction sets with fewer run single rows
        while row < self.windows.len() {
            if self.windows.len() - row >= TILE && L::REGISTERS >= 32 {
                self.tile::<T, L, G, TILE, N>(lanes, row, w, dy, gradient);
                row += TILE;
            } else if self.windows.len() - row >= 2 && L::REGISTERS >= 32 {
                self.tile::<T, L, G, 2, N>(lanes, row, w, dy, gradient);
                row += 2;
            } else {
                self.tile::<T, L, G, 1, N>(lanes, row, w, dy, gradient);
                row += 1;
            }
        }
    }

    #[inline(always)]
    fn tile<T: Real, L: Lanes<T>, const G: usize, const R: usize, const N: usize>(
        &self,
        lanes: L,
        row: usize,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let folds = fold_gradients::<T, L, G, R, N>(lanes, dy, self.windows.len(), row, w);
        let windows = &self.windows[row..];
        let patches = &self.conv.patches;
        patches.scatter_tap_sum_gradients::<T, L, R, N>(
            lanes, self.orbit, folds, gradient, windows, self.c,
        );
    }

    #[inline(always)]
    fn replicated<T: Real, L: Lanes<T>, const G: usize>(
        &self,
        lanes: L,
        w: &[Block<T>],
        dy: &[Block<T>],
        gradient: &mut [T],
    ) {
        let patches = &self.conv.patches;
        for (row, &window) in self.windows.iter().enumerate() {
            let [[fold]] = fold_gradients::<T, L, G, 1, 1>(lanes, dy, self.windows.len(), row, w);
            patches.scatter_replicated_gradient(
                lanes,
                self.orbit,
                fold,
                gradient,
                window + self.c * LANES,
            );
        }
    }
}

//! Output gradient of a convolution in the blocked layout, for the backward pass.

use crate::conv::maps::{Arena, FeatureMaps};
use crate::conv::operands::ConvBackwardOperands;
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::interleave::Interleaver;
use crate::simd::lanes::{Block, LANES, Lanes, unscaled_hadamard};

/// Maximum number of output pixels that the backward pass of a convolution handles at a time.
pub(crate) const MAX_GRADIENT_ROWS: usize = 64;

/// Buffers for the gradients of a convolution's backward pass.
pub(crate) struct ConvGradientScratch<'a, T> {
    /// Gradient with respect to the weights in the packed order of the CPU kernels.
    pub dw: &'a mut [Block<T>],
    /// Gradient with respect to the weights in the order of the parameters; `None` if that is the
    /// packed order and `dw` holds it.
    dweights: Option<&'a mut [T]>,
    dbias: &'a mut [Block<T>],
    dbiases: &'a mut [T],
    /// Gradient with respect to some output pixels, `[block][pixel]`.
    pub dy: &'a mut [Block<T>],
    /// Gradient with respect to some output pixels before its transposition, `[pixel][block]`.
    pixels: &'a mut [Block<T>],
    /// Im2col panel: folds (signed sums) of one orbit of taps in one block of channels for some
    /// output pixels, `[fold][pixel]`.
    pub panel: &'a mut [Block<T>],
}

impl<'a, T: Real> ConvGradientScratch<'a, T> {
    /// Returns the length of the buffers for up to [`MAX_GRADIENT_ROWS`] output pixels, in values.
    pub fn scratch_len(conv: &R2Conv) -> usize {
        let weights = &conv.weights;
        let panels = 4 * MAX_GRADIENT_ROWS + 2 * MAX_GRADIENT_ROWS * weights.blocks_per_pixel;
        (3 * weights.num_packed_blocks() + weights.blocks_per_pixel + panels) * LANES
    }

    /// Splits buffers for `rows` output pixels off the arena and takes the parameter gradient out
    /// of the pass.
    #[inline(always)]
    pub fn new(
        pass: &mut ConvBackwardOperands<'a, T>,
        arena: &mut Arena<'a, T>,
        rows: usize,
    ) -> Self {
        let (conv, layout) = (pass.conv, &pass.conv.weights);
        let width = layout.blocks_per_pixel;
        let dparams = std::mem::take(&mut pass.dparams);
        let (dweights, dbiases) = dparams.split_at_mut(conv.irrep_weights.bias_range().start);
        // parameters in packed order need no second buffer: their gradient is summed in place
        let (dw, dweights) = if layout.is_packed_already() {
            (&mut dweights.as_chunks_mut().0[..layout.num_packed_blocks()], None)
        } else {
            (arena.take_zeroed_blocks(layout.num_packed_blocks()), Some(dweights))
        };
        ConvGradientScratch {
            dw,
            dweights,
            dbias: arena.take_zeroed_blocks(width),
            dbiases,
            pixels: arena.take_zeroed_blocks(rows * width),
            dy: arena.take_blocks(rows * width),
            // an orbit has at most 4 taps and hence 4 folds
            panel: arena.take_blocks(rows * 4),
        }
    }

    /// Adds the gradients with respect to weights and bias to the parameter gradient.
    pub fn add_to_param_gradients<const G: usize>(self, conv: &R2Conv) {
        if let Some(dweights) = self.dweights {
            conv.weights.add_unpacked_gradient(self.dw, dweights);
        }
        let dbias = self.dbias.as_flattened().chunks_exact(G);
        for (d, group) in self.dbiases.iter_mut().zip(dbias) {
            *d += group[0];
        }
    }
}

/// Loader that brings the output gradient of a convolution into the blocked layout,
/// `[block][pixel]`.
pub(crate) struct GradientLoader<'a, T, L, const G: usize> {
    lanes: L,
    dy: FeatureMaps<'a, T>,
    masks: Option<&'a [T]>,
    interleaver: Interleaver,
    blocks_per_pixel: usize,
    /// Number of output pixels of an image.
    pub pixels_per_image: usize,
    channels: usize,
    regular: bool,
}

impl<'a, T: Real, L: Lanes<T>, const G: usize> GradientLoader<'a, T, L, G> {
    pub fn new(lanes: L, conv: &R2Conv, dy: FeatureMaps<'a, T>, masks: Option<&'a [T]>) -> Self {
        GradientLoader {
            lanes,
            dy,
            masks,
            interleaver: Interleaver::new(conv.out_shape.fields),
            blocks_per_pixel: conv.weights.blocks_per_pixel,
            pixels_per_image: conv.out_shape.num_pixels(),
            channels: conv.out_shape.fields.dim(),
            regular: conv.out_shape.fields.num_regular_fields().is_some(),
        }
    }

    /// Loads the output gradient of `count` pixels into `buffers.dy`, back through the ReLU if
    /// there is one, and adds it to the bias gradient.
    #[inline(always)]
    pub fn load_output_gradients(
        &self,
        first: usize,
        count: usize,
        buffers: &mut ConvGradientScratch<T>,
    ) {
        let mut first_blocks = [0; MAX_GRADIENT_ROWS];
        let first_blocks = &mut first_blocks[..count];
        let (from, scale) = match self.dy {
            FeatureMaps::Channels(dy) => {
                self.load_channels(&dy[first * self.channels..], buffers.pixels, first_blocks);
                (&*buffers.pixels, 1.0)
            }
            FeatureMaps::Blocked(patches, dy) => {
                patches.write_pixel_block_offsets(first, first_blocks);
                (dy.as_chunks().0, patches.blocked_value_scale())
            }
        };
        let pixels = PixelGradients { lanes: self.lanes, from, first_blocks, dbias: buffers.dbias };
        let masks = self.masks.map(|masks| &masks[first * self.blocks_per_pixel..]);
        match masks {
            None => pixels.copy(scale, buffers.dy),
            Some(masks) if self.regular => pixels.relu_backward::<G>(masks, scale, buffers.dy),
            Some(masks) => pixels.relu_backward::<1>(masks, scale, buffers.dy),
        }
    }

    /// Copies the output gradient of some pixels from channels into blocks, one pixel after the
    /// other.
    #[inline(always)]
    fn load_channels(&self, dy: &[T], pixels: &mut [Block<T>], first_blocks: &mut [usize]) {
        let channels = dy.chunks_exact(self.channels);
        let pixels = pixels.chunks_exact_mut(self.blocks_per_pixel);
        for (r, ((place, to), pixel_dy)) in
            first_blocks.iter_mut().zip(pixels).zip(channels).enumerate()
        {
            *place = r * self.blocks_per_pixel;
            self.interleaver.interleave::<T, G>(T::from_f64(1.0), pixel_dy, to.as_flattened_mut());
        }
    }
}

/// Gradient with respect to some output pixels, and the bias gradient to which it is added.
struct PixelGradients<'a, T, L> {
    lanes: L,
    from: &'a [Block<T>],
    /// Index, in `from`, of the first block of every pixel.
    first_blocks: &'a [usize],
    dbias: &'a mut [Block<T>],
}

impl<T: Real, L: Lanes<T>> PixelGradients<'_, T, L> {
    #[inline(always)]
    fn copy(self, scale: f64, panel: &mut [Block<T>]) {
        let (lanes, rows) = (self.lanes, self.first_blocks.len());
        let scale = lanes.splat(T::from_f64(scale));
        for (c, dbias) in self.dbias.iter_mut().enumerate() {
            let mut sum = lanes.load(dbias);
            let panel = &mut panel[c * rows..][..rows];
            for (to, place) in panel.iter_mut().zip(self.first_blocks) {
                let v = lanes.mul(lanes.load(&self.from[place + c]), scale);
                sum = lanes.add(sum, v);
                lanes.store(to, v);
            }
            lanes.store(dbias, sum);
        }
    }

    /// Zeroes the gradient of values that the ReLU zeroed, in the basis that the group permutes.
    #[inline(always)]
    fn relu_backward<const G: usize>(self, masks: &[T], scale: f64, panel: &mut [Block<T>]) {
        let (lanes, rows, width) = (self.lanes, self.first_blocks.len(), self.dbias.len());
        let masks = &masks[..rows * width];
        let scale = lanes.splat(T::from_f64(scale / G as f64));
        for (c, dbias) in self.dbias.iter_mut().enumerate() {
            let mut sum = lanes.load(dbias);
            let panel = &mut panel[c * rows..][..rows];
            for (r, (to, place)) in panel.iter_mut().zip(self.first_blocks).enumerate() {
                let v = unscaled_hadamard::<T, L, G>(lanes, lanes.load(&self.from[place + c]));
                let v = lanes.keep_masked(v, masks[r * width + c].to_mask());
                let v = lanes.mul(unscaled_hadamard::<T, L, G>(lanes, v), scale);
                sum = lanes.add(sum, v);
                lanes.store(to, v);
            }
            lanes.store(dbias, sum);
        }
    }
}

//! Last step of a convolution: bias, ReLU and output layout of the weighted sums.

use crate::conv::maps::{Arena, FeatureMapsMut};
use crate::conv::operands::ConvOutput;
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::interleave::Interleaver;
use crate::simd::lanes::{Block, Lanes, unscaled_hadamard};
use crate::simd::tiles::PANEL_ROWS;

/// Last step of a convolution's forward pass: adds the bias, applies the ReLU if there are masks
/// and writes the output.
pub(crate) struct Epilogue<'a, T, L, const G: usize> {
    lanes: L,
    blocks_per_pixel: usize,
    interleaver: Interleaver,
    channels: usize,
    regular: bool,
    bias: &'a [Block<T>],
    /// Buffer for the output pixels of one call of `run`.
    buffer: &'a mut [Block<T>],
    to: ConvOutput<'a, T>,
    /// Index, in the image, of the first output pixel that the pass computes.
    start: usize,
    /// Number of blocks of a blocked output image before the first pixel that the pass computes.
    blocks_before_start: usize,
}

impl<'a, T: Real, L: Lanes<T>, const G: usize> Epilogue<'a, T, L, G> {
    #[inline(always)]
    pub fn new(
        lanes: L,
        conv: &R2Conv,
        params: &[T],
        arena: &mut Arena<'a, T>,
        to: ConvOutput<'a, T>,
    ) -> Self {
        let width = conv.weights.blocks_per_pixel;
        let start = to.lines.start * conv.out_shape.width;
        let blocks_before_start = match &to.y {
            FeatureMapsMut::Channels(_) => 0,
            FeatureMapsMut::Blocked(patches, _) => patches.blocks_before_pixel(start),
        };
        // only trivial channels have a bias, and theirs is the first lane of each group
        let biases = &params[conv.irrep_weights.bias_range()];
        let bias = arena.take_zeroed_blocks(width);
        for (group, &b) in bias.as_flattened_mut().chunks_exact_mut(G).zip(biases) {
            group[0] = b;
        }
        Epilogue {
            lanes,
            blocks_per_pixel: width,
            interleaver: Interleaver::new(conv.out_shape.fields),
            channels: conv.out_shape.fields.dim(),
            regular: conv.out_shape.fields.num_regular_fields().is_some(),
            bias,
            buffer: arena.take_blocks(PANEL_ROWS * width),
            to,
            start,
            blocks_before_start,
        }
    }

    /// Adds the bias to the weighted sums of `count` output pixels, at most [`PANEL_ROWS`], applies
    /// the ReLU if there is one, and writes them from pixel `first` of the pass on.
    #[inline(always)]
    pub fn write_outputs(&mut self, sums: &[Block<T>], first: usize, count: usize) {
        let width = self.blocks_per_pixel;
        let mut first_blocks = [0; PANEL_ROWS];
        let (to, scale) = match &mut self.to.y {
            FeatureMapsMut::Channels(_) => {
                for (r, place) in first_blocks.iter_mut().enumerate() {
                    *place = r * width;
                }
                (&mut *self.buffer, 1.0)
            }
            FeatureMapsMut::Blocked(patches, y) => {
                let first_blocks = &mut first_blocks[..count];
                patches.write_pixel_block_offsets(self.start + first, first_blocks);
                for place in first_blocks {
                    *place -= self.blocks_before_start;
                }
                (y.as_chunks_mut().0, patches.blocked_value_scale())
            }
        };
        let sums = PixelSums {
            lanes: self.lanes,
            sums: &sums[..count * width],
            bias: self.bias,
            first_blocks: &first_blocks[..count],
        };
        let masks = self.to.masks.as_deref_mut();
        match masks.map(|masks| &mut masks[first * width..][..count * width]) {
            // regular fields are rectified in the regular basis, trivial channels as they are
            Some(masks) if self.regular => sums.add_bias_and_relu::<G>(masks, scale, to),
            Some(masks) => sums.add_bias_and_relu::<1>(masks, scale, to),
            None => sums.add_bias(scale, to),
        }
        self.write_channels(first, count);
    }

    /// Copies the output pixels from the buffer to the channels of the output, unless the output is
    /// blocked.
    #[inline(always)]
    fn write_channels(&mut self, first: usize, count: usize) {
        if let FeatureMapsMut::Channels(y) = &mut self.to.y {
            let pixels = y[first * self.channels..].chunks_exact_mut(self.channels);
            let rows = self.buffer.chunks_exact(self.blocks_per_pixel);
            for (own_row, pixel) in rows.take(count).zip(pixels) {
                self.interleaver.deinterleave_channels::<T, G>(
                    T::from_f64(1.0),
                    own_row.as_flattened(),
                    pixel,
                );
            }
        }
    }
}

/// Weighted sums `[pixel][block]` of some output pixels of a convolution, before bias and ReLU.
struct PixelSums<'a, T, L> {
    lanes: L,
    sums: &'a [Block<T>],
    bias: &'a [Block<T>],
    /// Index, in the output, of the first block of every pixel.
    first_blocks: &'a [usize],
}

impl<T: Real, L: Lanes<T>> PixelSums<'_, T, L> {
    #[inline(always)]
    fn add_bias(&self, scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let scale = lanes.splat(T::from_f64(scale));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.first_blocks.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                lanes.store(&mut to[place + c], lanes.mul(v, scale));
            }
        }
    }

    /// Writes the output pixels after adding the bias and applying the ReLU in the basis that the
    /// group permutes.
    #[inline(always)]
    fn add_bias_and_relu<const G: usize>(&self, masks: &mut [T], scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let masks = &mut masks[..self.sums.len()];
        // two unscaled transforms multiply by G, which the scale takes back
        let scale = lanes.splat(T::from_f64(scale / G as f64));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.first_blocks.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                let (v, bits) = lanes.relu_with_mask(unscaled_hadamard::<T, L, G>(lanes, v));
                masks[r * width + c] = T::from_mask(bits);
                let v = lanes.mul(unscaled_hadamard::<T, L, G>(lanes, v), scale);
                lanes.store(&mut to[place + c], v);
            }
        }
    }
}

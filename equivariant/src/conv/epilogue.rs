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
    width: usize,
    interleaver: Interleaver,
    channels: usize,
    regular: bool,
    bias: &'a [Block<T>],
    /// Buffer for the output pixels of one call of `run`.
    own: &'a mut [Block<T>],
    to: ConvOutput<'a, T>,
    /// Index, in the image, of the first output pixel that the pass computes.
    start: usize,
    /// Number of blocks of a staged output image before the first pixel that the pass computes.
    skipped: usize,
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
        let skipped = match &to.y {
            FeatureMapsMut::Channels(_) => 0,
            FeatureMapsMut::Staged(patches, _) => patches.blocks_before_pixel(start),
        };
        // only trivial channels have a bias, and theirs is the first lane of each group
        let biases = &params[conv.blocks.bias_range()];
        let bias = arena.take_zeroed_blocks(width);
        for (group, &b) in bias.as_flattened_mut().chunks_exact_mut(G).zip(biases) {
            group[0] = b;
        }
        Epilogue {
            lanes,
            width,
            interleaver: Interleaver::new(conv.out_shape.fields),
            channels: conv.out_shape.fields.dim(),
            regular: conv.out_shape.fields.num_regular_fields().is_some(),
            bias,
            own: arena.take_blocks(PANEL_ROWS * width),
            to,
            start,
            skipped,
        }
    }

    /// Writes `count` output pixels of a convolution from pixel `first` on, at most [`PANEL_ROWS`]
    /// of them.
    #[inline(always)]
    pub fn run(&mut self, sums: &[Block<T>], first: usize, count: usize) {
        let width = self.width;
        let mut places = [0; PANEL_ROWS];
        let (to, scale) = match &mut self.to.y {
            FeatureMapsMut::Channels(_) => {
                for (r, place) in places.iter_mut().enumerate() {
                    *place = r * width;
                }
                (&mut *self.own, 1.0)
            }
            FeatureMapsMut::Staged(patches, y) => {
                let places = &mut places[..count];
                patches.write_pixel_blocks(self.start + first, places);
                for place in places {
                    *place -= self.skipped;
                }
                (y.as_chunks_mut().0, patches.staging_scale())
            }
        };
        let sums = PixelSums {
            lanes: self.lanes,
            sums: &sums[..count * width],
            bias: self.bias,
            places: &places[..count],
        };
        let masks = self.to.masks.as_deref_mut();
        match masks.map(|masks| &mut masks[first * width..][..count * width]) {
            // regular fields are rectified in the regular basis, trivial channels as they are
            Some(masks) if self.regular => sums.rectify::<G>(masks, scale, to),
            Some(masks) => sums.rectify::<1>(masks, scale, to),
            None => sums.add_bias(scale, to),
        }
        self.write_channels(first, count);
    }

    /// Copies the output pixels from the buffer to the channels of the output, unless the output is
    /// staged.
    #[inline(always)]
    fn write_channels(&mut self, first: usize, count: usize) {
        if let FeatureMapsMut::Channels(y) = &mut self.to.y {
            let pixels = y[first * self.channels..].chunks_exact_mut(self.channels);
            let own = self.own.chunks_exact(self.width);
            for (own_row, pixel) in own.take(count).zip(pixels) {
                self.interleaver.deinterleave::<T, G>(
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
    places: &'a [usize],
}

impl<T: Real, L: Lanes<T>> PixelSums<'_, T, L> {
    #[inline(always)]
    fn add_bias(&self, scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let scale = lanes.splat(T::from_f64(scale));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.places.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                lanes.store(&mut to[place + c], lanes.mul(v, scale));
            }
        }
    }

    /// Writes the output pixels after adding the bias and applying the ReLU in the basis that the
    /// group permutes.
    #[inline(always)]
    fn rectify<const G: usize>(&self, masks: &mut [T], scale: f64, to: &mut [Block<T>]) {
        let (lanes, width) = (self.lanes, self.bias.len());
        let masks = &mut masks[..self.sums.len()];
        // two unscaled transforms multiply by G, which the scale takes back
        let scale = lanes.splat(T::from_f64(scale / G as f64));
        for (c, bias) in self.bias.iter().enumerate() {
            let bias = lanes.load(bias);
            for (r, place) in self.places.iter().enumerate() {
                let v = lanes.add(lanes.load(&self.sums[r * width + c]), bias);
                let (v, bits) = lanes.relu_with_mask(unscaled_hadamard::<T, L, G>(lanes, v));
                masks[r * width + c] = T::from_mask(bits);
                let v = lanes.mul(unscaled_hadamard::<T, L, G>(lanes, v), scale);
                lanes.store(&mut to[place + c], v);
            }
        }
    }
}

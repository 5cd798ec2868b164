//! Max-pooling between the convolutions of a chain.
//!
//! A pooling reads the output of the convolution before it in the blocked layout and
//! writes the blocked image of the next one. Fields are transformed to the regular basis in
//! registers; no map is converted to irrep-major channels.

use crate::conv::maps::{Arena, FeatureMaps, FeatureMapsMut};
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::shape::Shape;
use crate::simd::interleave::Interleaver;
use crate::simd::lanes::{Block, InstructionSet, LANES, Lanes, WithLanes, unscaled_hadamard};
use crate::simd::patches::PatchGeometry;
use crate::steerable::hadamard::with_const_order;
use crate::steerable::taps::TapBasis;
use crate::window::SlidingWindow;

/// Maximum number of pixels of a pooling window that is fused with a convolution.
const MAX_WINDOW_PIXELS: usize = 16;

/// Max-pooling of regular fields after a convolution, with windows that tile the image.
#[derive(Clone, Debug)]
pub(crate) struct FusedMaxPool {
    /// Layout of the feature maps before the pooling: that of the CPU kernels, without padding or
    /// folds.
    pub patches: PatchGeometry,
    pub out_shape: Shape,
    /// Index of the first pixel of every pooling window, in blocks of a blocked image.
    windows: Vec<usize>,
    /// Distances of the pixels of a pooling window from its first pixel, in blocks of a blocked
    /// image.
    taps: Vec<usize>,
    pub widest_instruction_set: InstructionSet,
}

impl FusedMaxPool {
    /// Creates the max-pooling of a convolution's output; `None` if it cannot be fused: the windows
    /// overlap, leave pixels out or are too large, or the channels are not regular fields.
    pub fn after_conv(conv: &R2Conv, kernel: SlidingWindow) -> Option<FusedMaxPool> {
        let image = conv.out_shape;
        let size = kernel.size;
        let tiles = [image.height, image.width].map(|side| side / size);
        let whole = tiles.map(|count| count * size) == [image.height, image.width];
        let apart = kernel == SlidingWindow::new(size, size, 0) && size * size <= MAX_WINDOW_PIXELS;
        image.fields.num_regular_fields()?;
        if !(whole && apart) {
            return None;
        }
        // a window of one pixel gives the blocked layout without padding and without folds
        let pixel = SlidingWindow::new(1, 1, 0);
        let size_of = [image.height, image.width];
        let patches = PatchGeometry::new(&TapBasis::new(image.fields, 1), image, pixel, size_of);
        let at = |y: usize, x: usize| patches.pixel_starts[y * image.width + x] / LANES;
        let grid = |[height, width]: [usize; 2], step: usize| -> Vec<usize> {
            let lines = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
            lines.map(|(y, x)| at(y * step, x * step)).collect()
        };
        Some(FusedMaxPool {
            windows: grid(tiles, size),
            taps: grid([size, size], 1),
            out_shape: Shape::image(tiles[0], tiles[1], image.fields),
            widest_instruction_set: conv.widest_instruction_set,
            patches,
        })
    }

    /// Returns the length of the scratch memory of a pooling pass, in values: the blocks of one
    /// pixel.
    pub fn scratch_len(&self) -> usize {
        self.patches.blocks_per_pixel * LANES
    }

    /// Returns the factor from layout scale `from` to layout scale `to` that also normalises two
    /// Hadamard transforms.
    fn scale(&self, from: f64, to: f64) -> f64 {
        to / from / self.out_shape.fields.group().order() as f64
    }
}

/// Operands of the forward pass of a fused max-pooling.
pub struct MaxPoolForwardOperands<'a, T> {
    pub(crate) pool: &'a FusedMaxPool,
    pub(crate) samples: usize,
    /// Input of the max-pooling, in the blocked layout.
    pub(crate) x: &'a [T],
    pub(crate) y: FeatureMapsMut<'a, T>,
    pub(crate) scratch: &'a mut [T],
}

/// Operands of the backward pass of a fused max-pooling.
pub struct MaxPoolBackwardOperands<'a, T> {
    pub(crate) pool: &'a FusedMaxPool,
    pub(crate) samples: usize,
    /// Input of the max-pooling in the forward pass, in the blocked layout.
    pub(crate) x: &'a [T],
    pub(crate) dy: FeatureMaps<'a, T>,
    /// Gradient with respect to the input of the max-pooling, in the blocked layout;
    /// overwritten.
    pub(crate) dx: &'a mut [T],
    pub(crate) scratch: &'a mut [T],
}

impl<T: Real> WithLanes<T> for MaxPoolForwardOperands<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        with_const_order!(
            G = self.pool.out_shape.fields.group().order(),
            self.run_groups::<L, G>(lanes)
        );
    }
}

impl<T: Real> MaxPoolForwardOperands<'_, T> {
    #[inline(always)]
    fn run_groups<L: Lanes<T>, const G: usize>(mut self, lanes: L) {
        let (pool, own) = (self.pool, self.pool.patches.blocked_value_scale());
        let (blocks, channels) = (pool.patches.blocks_per_pixel, pool.out_shape.fields.dim());
        let room = Arena::new(self.scratch).take_blocks(blocks);
        let interleaver = Interleaver::new(pool.out_shape.fields);
        let images = self.x.as_chunks().0;
        let images = images.chunks_exact(pool.patches.blocked_len() / LANES);
        for (n, x) in images.take(self.samples).enumerate() {
            for (i, &window) in pool.windows.iter().enumerate() {
                match &mut self.y {
                    FeatureMapsMut::Channels(y) => {
                        window_maximum::<T, L, G>(
                            lanes,
                            pool,
                            &x[window..],
                            pool.scale(own, 1.0),
                            room,
                        );
                        let pixel = n * pool.windows.len() + i;
                        let y = &mut y[pixel * channels..][..channels];
                        interleaver.deinterleave_channels::<T, G>(
                            T::from_f64(1.0),
                            room.as_flattened(),
                            y,
                        );
                    }
                    FeatureMapsMut::Blocked(patches, y) => {
                        let at = n * patches.blocked_len() + patches.pixel_starts[i];
                        let y = &mut y[at..][..blocks * LANES];
                        let scale = pool.scale(own, patches.blocked_value_scale());
                        window_maximum::<T, L, G>(
                            lanes,
                            pool,
                            &x[window..],
                            scale,
                            y.as_chunks_mut().0,
                        );
                    }
                }
            }
        }
    }
}

/// Writes the maximum of every channel, in the regular basis, over the pooling window at the start
/// of `x`.
#[inline(always)]
fn window_maximum<T: Real, L: Lanes<T>, const G: usize>(
    lanes: L,
    pool: &FusedMaxPool,
    x: &[Block<T>],
    scale: f64,
    y: &mut [Block<T>],
) {
    let scale = lanes.splat(T::from_f64(scale));
    for (c, out) in y.iter_mut().enumerate() {
        let mut best = unscaled_hadamard::<T, L, G>(lanes, lanes.load(&x[c]));
        for tap in &pool.taps[1..] {
            let v = unscaled_hadamard::<T, L, G>(lanes, lanes.load(&x[tap + c]));
            best = lanes.max_with_mask(best, v).0;
        }
        let best = unscaled_hadamard::<T, L, G>(lanes, best);
        lanes.store(out, lanes.mul(best, scale));
    }
}

impl<T: Real> WithLanes<T> for MaxPoolBackwardOperands<'_, T> {
    #[inline(always)]
    fn run<L: Lanes<T>>(self, lanes: L) {
        with_const_order!(
            G = self.pool.out_shape.fields.group().order(),
            self.run_groups::<L, G>(lanes)
        );
    }
}

impl<T: Real> MaxPoolBackwardOperands<'_, T> {
    #[inline(always)]
    fn run_groups<L: Lanes<T>, const G: usize>(self, lanes: L) {
        let (pool, own) = (self.pool, self.pool.patches.blocked_value_scale());
        let (blocks, channels) = (pool.patches.blocks_per_pixel, pool.out_shape.fields.dim());
        // zeros, because lanes without a channel are never written below
        let room = Arena::new(self.scratch).take_zeroed_blocks(blocks);
        let one = T::from_f64(1.0);
        let interleaver = Interleaver::new(pool.out_shape.fields);
        let blocked = pool.patches.blocked_len() / LANES;
        let images = self.x.as_chunks().0.chunks_exact(blocked);
        let gradients = self.dx.as_chunks_mut().0.chunks_exact_mut(blocked);
        for (n, (x, dx)) in images.zip(gradients).take(self.samples).enumerate() {
            for (i, &window) in pool.windows.iter().enumerate() {
                // blocked values are scaled, so their gradient is that of the values divided by the
                // scale
                let (dy, scale) = match self.dy {
                    FeatureMaps::Channels(dy) => {
                        let pixel = n * pool.windows.len() + i;
                        let dy = &dy[pixel * channels..][..channels];
                        interleaver.interleave::<T, G>(one, dy, room.as_flattened_mut());
                        (&*room, pool.scale(own, 1.0))
                    }
                    FeatureMaps::Blocked(patches, dy) => {
                        let at = n * patches.blocked_len() + patches.pixel_starts[i];
                        let dy = &dy[at..][..blocks * LANES];
                        (dy.as_chunks().0, pool.scale(own, patches.blocked_value_scale()))
                    }
                };
                let (x, dx) = (&x[window..], &mut dx[window..]);
                scatter_to_maximum::<T, L, G>(lanes, pool, x, dy, scale, dx);
            }
        }
    }
}

/// Routes the gradient of one pooling window to the first pixel that holds the maximum. If a pixel
/// is NaN it receives the gradient, which [`MaxPool`](crate::MaxPool) drops.
#[inline(always)]
fn scatter_to_maximum<T: Real, L: Lanes<T>, const G: usize>(
    lanes: L,
    pool: &FusedMaxPool,
    x: &[Block<T>],
    dy: &[Block<T>],
    scale: f64,
    dx: &mut [Block<T>],
) {
    let scale = lanes.splat(T::from_f64(scale));
    for (c, gradient) in dy.iter().enumerate() {
        let mut won = [0; MAX_WINDOW_PIXELS];
        // the first pixel holds the maximum until a larger one is found
        won[0] = u16::MAX;
        let mut best = unscaled_hadamard::<T, L, G>(lanes, lanes.load(&x[c]));
        for (i, tap) in pool.taps.iter().enumerate().skip(1) {
            let v = unscaled_hadamard::<T, L, G>(lanes, lanes.load(&x[tap + c]));
            (best, won[i]) = lanes.max_with_mask(best, v);
            // a later, larger value takes the win from all earlier ones
            for earlier in 0..i {
                won[earlier] &= !won[i];
            }
        }
        let gradient = unscaled_hadamard::<T, L, G>(lanes, lanes.load(gradient));
        for (&tap, &selected) in pool.taps.iter().zip(&won) {
            let d = unscaled_hadamard::<T, L, G>(lanes, lanes.keep_masked(gradient, selected));
            lanes.store(&mut dx[tap + c], lanes.mul(d, scale));
        }
    }
}

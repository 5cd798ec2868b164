//! Fused chains of convolutions, ReLUs and max-poolings.
//!
//! Between the convolutions of a chain the feature maps keep the blocked layout: a
//! convolution, or the pooling after it, writes its output directly into the blocked image of the
//! next one, which the backward pass reads, too. Of the values before a ReLU only the signs are
//! saved.

use std::fmt;
use std::ops::Range;

use crate::conv::dispatch::{self, ConvScalar};
use crate::conv::maps::{Arena, ConvInput, FeatureMaps, FeatureMapsMut};
use crate::conv::operands::{ConvBackwardOperands, ConvForwardOperands, ConvOutput};
use crate::conv::pool::{FusedMaxPool, MaxPoolBackwardOperands, MaxPoolForwardOperands};
use crate::conv::r2_conv::R2Conv;
use crate::layers::layer::{Layer, LayerSignature, Scalar};
use crate::scratch::{BackwardArgs, take_back_padded};
use crate::shape::Shape;
use crate::simd::lanes::LANES;
use crate::window::SlidingWindow;

/// Sequence of convolutions, each optionally followed by a ReLU and then by a max-pooling.
#[derive(Clone, Debug)]
pub(crate) struct FusedChain {
    convs: Vec<FusedConv>,
}

/// Convolution of a fused chain, with the ReLU and the max-pooling that are fused with it.
#[derive(Clone, Debug)]
struct FusedConv {
    conv: R2Conv,
    rectified: bool,
    pool: Option<FusedMaxPool>,
    params: Range<usize>,
}

impl FusedChain {
    /// Creates a fused chain of one convolution.
    pub fn new(conv: &R2Conv) -> FusedChain {
        let mut chain = FusedChain { convs: Vec::new() };
        chain.push(conv);
        chain
    }

    fn push(&mut self, conv: &R2Conv) {
        let start = self.convs.last().map_or(0, |fused| fused.params.end);
        self.convs.push(FusedConv {
            conv: conv.clone(),
            rectified: false,
            pool: None,
            params: start..start + conv.irrep_weights.num_params(),
        });
    }

    /// Appends a convolution to the fused chain and returns `true`, or returns `false` if it cannot
    /// be fused. Trivial channels cannot: their blocked layout differs from the layout in which
    /// outputs are written.
    pub fn try_append_conv(&mut self, conv: &R2Conv) -> bool {
        let fits = !conv.patches.is_replicated;
        if fits {
            self.push(conv);
        }
        fits
    }

    /// Appends a ReLU to the fused chain and returns `true`, or returns `false` if the last
    /// convolution has a ReLU or pooling.
    pub fn try_append_relu(&mut self) -> bool {
        let last = self.last_mut();
        last.pool.is_none() && !std::mem::replace(&mut last.rectified, true)
    }

    /// Appends a max-pooling to the fused chain and returns `true`, or returns `false` if the last
    /// convolution is pooled or the windows do not qualify (see [`FusedMaxPool::after_conv`]).
    pub fn try_append_max_pool(&mut self, kernel: SlidingWindow) -> bool {
        let last = self.last_mut();
        if last.pool.is_some() {
            return false;
        }
        last.pool = FusedMaxPool::after_conv(&last.conv, kernel);
        last.pool.is_some()
    }

    fn last(&self) -> &FusedConv {
        &self.convs[self.convs.len() - 1]
    }

    fn last_mut(&mut self) -> &mut FusedConv {
        let last = self.convs.len() - 1;
        &mut self.convs[last]
    }

    /// Returns the number of values that the chain's forward pass saves for its backward pass.
    fn saved_len(&self, samples: usize) -> usize {
        let convs = self.convs.iter().enumerate();
        convs
            .map(|(i, fused)| {
                self.blocked_input_len(i, samples)
                    + fused.masks_len(samples)
                    + fused.pool_input_len(samples)
            })
            .sum()
    }

    /// Returns the length of the input of convolution `i` of the chain in the blocked
    /// layout; 0 for the first, which reads plain channels.
    fn blocked_input_len(&self, i: usize, samples: usize) -> usize {
        match i {
            0 => 0,
            _ => samples * self.convs[i].conv.patches.blocked_len(),
        }
    }

    /// Returns the length of the largest map between the chain's convolutions and poolings, in the
    /// layout of the CPU kernels.
    fn largest_map_len(&self, samples: usize) -> usize {
        let convs = self.convs.iter().enumerate();
        let largest = convs.map(|(i, fused)| {
            self.blocked_input_len(i, samples).max(fused.pool_input_len(samples))
        });
        largest.max().unwrap_or(0)
    }

    /// Writes the output of the chain for `samples` samples; `x` holds channels or bytes.
    pub fn forward_from_input<T: ConvScalar>(
        &self,
        params: &[T],
        samples: usize,
        x: ConvInput<T>,
        y: &mut [T],
        scratch: &mut [T],
    ) {
        let mut arena = Arena::new(scratch);
        let mut saved = Arena::new(arena.take_values(self.saved_len(samples)));
        let rest = arena.take_rest();
        let mut input = x;
        for (i, pair) in self.convs.windows(2).enumerate() {
            let own = pair[0].take_saved(samples, &mut saved);
            let blocked = saved.take_values(self.blocked_input_len(i + 1, samples));
            let patches = &pair[1].conv.patches;
            let images = blocked.chunks_exact_mut(patches.blocked_len());
            // the convolution writes the pixels only, and the scratch may hold other values in the
            // padding
            images.for_each(|image| patches.clear_border(image));
            let target = FeatureMapsMut::Blocked(patches, blocked);
            pair[0].forward(params, samples, input, target, own, rest);
            input = ConvInput::Blocked(blocked);
        }
        let own = self.last().take_saved(samples, &mut saved);
        let y = FeatureMapsMut::Channels(y);
        self.last().forward(params, samples, input, y, own, rest);
    }

    /// Adds the gradients with respect to the parameters and, if it is needed, writes the gradient
    /// with respect to the input; `x` replaces `args.x`.
    pub fn backward_to_input<T: ConvScalar>(
        &self,
        samples: usize,
        x: ConvInput<T>,
        args: BackwardArgs<T>,
    ) {
        let mut arena = Arena::new(args.scratch);
        let mut saved = arena.take_values(self.saved_len(samples));
        let mut output_gradient = arena.take_values(self.largest_map_len(samples));
        let mut input_gradient = arena.take_values(self.largest_map_len(samples));
        let scratch = arena.take_rest();
        let mut dx = args.dx;
        for (i, fused) in self.convs.iter().enumerate().rev() {
            let patches = &fused.conv.patches;
            // lengths are whole blocks, which have no padding
            let pool_input = take_back_padded(&mut saved, fused.pool_input_len(samples));
            let masks = &*take_back_padded(&mut saved, fused.masks_len(samples));
            let blocked = take_back_padded(&mut saved, self.blocked_input_len(i, samples));
            let mut dy = match self.convs.get(i + 1) {
                None => FeatureMaps::Channels(args.dy),
                Some(next) => FeatureMaps::Blocked(&next.conv.patches, output_gradient),
            };
            if let Some(pool) = &fused.pool {
                let pool_gradient = &mut input_gradient[..pool_input.len()];
                T::max_pool_backward(MaxPoolBackwardOperands {
                    pool,
                    samples,
                    x: pool_input,
                    dy,
                    dx: pool_gradient,
                    scratch,
                });
                std::mem::swap(&mut output_gradient, &mut input_gradient);
                dy = FeatureMaps::Blocked(&pool.patches, output_gradient);
            }
            let (x, dx) = match i {
                0 => (x, dx.take().map(FeatureMapsMut::Channels)),
                _ => {
                    let blocked_gradient = &mut input_gradient[..blocked.len()];
                    (
                        ConvInput::Blocked(blocked),
                        Some(FeatureMapsMut::Blocked(patches, blocked_gradient)),
                    )
                }
            };
            T::backward(ConvBackwardOperands {
                conv: &fused.conv,
                samples,
                params: &args.params[fused.params.clone()],
                x,
                dy,
                masks: fused.rectified.then_some(masks),
                dx,
                dparams: &mut args.dparams[fused.params.clone()],
                scratch,
            });
            std::mem::swap(&mut output_gradient, &mut input_gradient);
        }
    }
}

/// Buffers for the values that a convolution with its ReLU and pooling saves for the backward pass.
struct SavedForBackward<'a, T> {
    masks: &'a mut [T],
    /// Input of the max-pooling after the convolution, in the blocked layout.
    pool_input: &'a mut [T],
}

impl FusedConv {
    fn out(&self) -> Shape {
        self.pool.as_ref().map_or(self.conv.out_shape, |pool| pool.out_shape)
    }

    /// Splits the buffers of this convolution with its ReLU and pooling off the saved values.
    fn take_saved<'a, T: ConvScalar>(
        &self,
        samples: usize,
        saved: &mut Arena<'a, T>,
    ) -> SavedForBackward<'a, T> {
        SavedForBackward {
            masks: saved.take_values(self.masks_len(samples)),
            pool_input: saved.take_values(self.pool_input_len(samples)),
        }
    }

    fn forward<T: ConvScalar>(
        &self,
        params: &[T],
        samples: usize,
        x: ConvInput<T>,
        y: FeatureMapsMut<T>,
        saved: SavedForBackward<T>,
        scratch: &mut [T],
    ) {
        let Some(pool) = &self.pool else {
            return self.convolve(params, samples, x, y, saved.masks, scratch);
        };
        let before = FeatureMapsMut::Blocked(&pool.patches, &mut *saved.pool_input);
        self.convolve(params, samples, x, before, saved.masks, scratch);
        T::max_pool_forward(MaxPoolForwardOperands {
            pool,
            samples,
            x: saved.pool_input,
            y,
            scratch,
        });
    }

    fn convolve<T: ConvScalar>(
        &self,
        params: &[T],
        samples: usize,
        x: ConvInput<T>,
        y: FeatureMapsMut<T>,
        masks: &mut [T],
        scratch: &mut [T],
    ) {
        let pass = ConvForwardOperands {
            conv: &self.conv,
            samples,
            params: &params[self.params.clone()],
            x,
            output: ConvOutput {
                lines: 0..self.conv.out_shape.height,
                y,
                masks: self.rectified.then_some(masks),
            },
            scratch,
        };
        pass.run_on_threads();
    }

    /// Returns the length of the input of the max-pooling; 0 without a pooling.
    fn pool_input_len(&self, samples: usize) -> usize {
        self.pool.as_ref().map_or(0, |pool| samples * pool.patches.blocked_len())
    }

    /// Returns the length of the bit masks that the ReLU saves, in whole blocks; 0 without a ReLU.
    fn masks_len(&self, samples: usize) -> usize {
        let rows = samples * self.conv.out_shape.num_pixels();
        let masks = rows * self.conv.weights.blocks_per_pixel;
        if self.rectified { masks.next_multiple_of(LANES) } else { 0 }
    }
}

impl LayerSignature for FusedChain {
    fn in_shape(&self) -> Shape {
        self.convs[0].conv.image_shape()
    }

    fn out_shape(&self) -> Shape {
        self.last().out()
    }

    fn num_params(&self) -> usize {
        self.last().params.end
    }

    fn scratch_len(&self, samples: usize) -> usize {
        let convs = self.convs.iter().enumerate();
        let passes = convs.map(|(i, fused)| {
            let pool = fused.pool.as_ref().map_or(0, FusedMaxPool::scratch_len);
            dispatch::scratch_len(&fused.conv, samples, i > 0).max(pool)
        });
        // saved values, two buffers for gradients between convolutions, and working space that they
        // share
        let own = self.saved_len(samples) + 2 * self.largest_map_len(samples);
        own + passes.max().unwrap_or(0)
    }

    fn backward_reads_scratch(&self) -> bool {
        self.saved_len(1) > 0
    }
}

impl<T: Scalar> Layer<T> for FusedChain {
    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        let samples = x.len() / self.in_shape().len();
        self.forward_from_input(params, samples, ConvInput::Channels(x), y, scratch);
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        let samples = args.x.len() / self.in_shape().len();
        self.backward_to_input(samples, ConvInput::Channels(args.x), args);
    }
}

impl fmt::Display for FusedChain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shapes: Vec<String> = self.convs.iter().map(|fused| fused.out().to_string()).collect();
        write!(f, "Chain({} -> {})", self.in_shape(), shapes.join(" -> "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::{FieldType, Group};

    /// Creates a convolution of a 6 x 8 map to this type.
    fn conv(to: FieldType) -> R2Conv {
        let from = to.group().trivial_type(3);
        R2Conv::new(from, to, SlidingWindow::new(3, 1, 1), [6, 8]).unwrap()
    }

    /// Returns `true` if a pooling of a rectified convolution to this type is fused.
    fn pools(to: FieldType, [size, stride, padding]: [usize; 3]) -> bool {
        let mut chain = FusedChain::new(&conv(to));
        assert!(chain.try_append_relu() && !chain.try_append_relu());
        let pooled = chain.try_append_max_pool(SlidingWindow::new(size, stride, padding));
        assert!(!(pooled && chain.try_append_relu()), "a ReLU behind a pooling");
        pooled
    }

    #[test]
    fn poolings_whose_windows_tile_the_map_are_fused() {
        for group in Group::ALL {
            assert!(pools(group.regular_type(3), [2, 2, 0]));
            assert!(pools(group.regular_type(3), [1, 1, 0]));
        }
        let overlapping = [3, 1, 1];
        let beyond_the_map = [4, 4, 0];
        for pool in [overlapping, beyond_the_map, [2, 1, 0], [5, 5, 0]] {
            assert!(!pools(Group::C1.regular_type(3), pool), "{pool:?}");
        }
        assert!(!pools(Group::D2.trivial_type(3), [2, 2, 0]));
    }
}

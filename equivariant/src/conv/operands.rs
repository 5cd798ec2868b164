//! Operands of the passes of a convolution.

use std::ops::Range;

use crate::conv::maps::{ConvInput, FeatureMaps, FeatureMapsMut};
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::lanes::LANES;

/// Operands of a convolution's forward pass.
pub struct ConvForwardOperands<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) params: &'a [T],
    pub(crate) x: ConvInput<'a, T>,
    pub(crate) output: ConvOutput<'a, T>,
    pub(crate) scratch: &'a mut [T],
}

/// Output of a convolution's forward pass: buffers, and the lines to compute.
pub(crate) struct ConvOutput<'a, T> {
    /// Range of the lines of output pixels to compute; all lines unless there is one sample. `y`
    /// and `masks` start with the first of them.
    pub lines: Range<usize>,
    pub y: FeatureMapsMut<'a, T>,
    /// Buffer for a bit mask of the values that a ReLU passes, one number for each block of
    /// outputs; `None` without a ReLU.
    pub masks: Option<&'a mut [T]>,
}

/// Operands of a convolution's backward pass.
pub struct ConvBackwardOperands<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) x: ConvInput<'a, T>,
    pub(crate) dy: FeatureMaps<'a, T>,
    pub(crate) dx: Option<FeatureMapsMut<'a, T>>,
    /// Bit masks of the values that the ReLU of the forward pass passed; `None` without a ReLU.
    pub(crate) masks: Option<&'a [T]>,
    pub(crate) params: &'a [T],
    pub(crate) dparams: &'a mut [T],
    pub(crate) scratch: &'a mut [T],
}

impl<T: Real> ConvForwardOperands<'_, T> {
    /// Splits the forward pass over a single image into two: the upper and the lower lines of
    /// output pixels.
    pub(crate) fn split_in_half(self) -> (Self, Self) {
        let (above, below) = self.output.split_in_half(self.conv);
        // whole blocks, so that both halves start on a cache line
        let middle = self.scratch.len() / 2 / LANES * LANES;
        let (scratch, scratch_below) = self.scratch.split_at_mut(middle);
        let above = ConvForwardOperands { output: above, scratch, ..self };
        let below = ConvForwardOperands { output: below, scratch: scratch_below, ..above };
        (above, below)
    }
}

impl<T: Real> ConvOutput<'_, T> {
    /// Splits the output of a single image into two: the upper and the lower lines of pixels.
    fn split_in_half(self, conv: &R2Conv) -> (Self, Self) {
        let middle = conv.out_shape.height / 2;
        let pixels = middle * conv.out_shape.width;
        let (y, y_below) = self.y.split_at_pixel(pixels, conv.out_shape.fields.dim());
        let at = pixels * conv.weights.blocks_per_pixel;
        let (masks, masks_below) = self.masks.map(|masks| masks.split_at_mut(at)).unzip();
        let above = ConvOutput { lines: 0..middle, y, masks };
        let below =
            ConvOutput { lines: middle..conv.out_shape.height, y: y_below, masks: masks_below };
        (above, below)
    }
}

//! Operands of the passes of a convolution.

use std::ops::Range;

use crate::conv::maps::{Input, Maps, MapsMut};
use crate::conv::r2_conv::R2Conv;
use crate::real::Real;
use crate::simd::lanes::LANES;

/// Everything that a forward pass reads and writes.
pub struct Forward<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) params: &'a [T],
    pub(crate) x: Input<'a, T>,
    pub(crate) to: Output<'a, T>,
    pub(crate) scratch: &'a mut [T],
}

/// Output of a forward pass.
pub(crate) struct Output<'a, T> {
    /// Which lines of the output; all of them unless there is one sample. `y` and `masks` begin
    /// with the first.
    pub lines: Range<usize>,
    pub y: MapsMut<'a, T>,
    /// Room for the values that a ReLU passes, a number for every block of outputs; none for no
    /// ReLU.
    pub masks: Option<&'a mut [T]>,
}

/// Everything that a backward pass reads and writes.
pub struct Backward<'a, T> {
    pub(crate) conv: &'a R2Conv,
    pub(crate) samples: usize,
    pub(crate) x: Input<'a, T>,
    pub(crate) dy: Maps<'a, T>,
    pub(crate) dx: Option<MapsMut<'a, T>>,
    /// Which values the ReLU of the forward pass let through; none for no ReLU.
    pub(crate) masks: Option<&'a [T]>,
    pub(crate) params: &'a [T],
    pub(crate) dparams: &'a mut [T],
    pub(crate) scratch: &'a mut [T],
}

impl<T: Real> Forward<'_, T> {
    /// The pass over the upper and that over the lower lines of a single image.
    pub(crate) fn halves(self) -> (Self, Self) {
        let (above, below) = self.to.halves(self.conv);
        // whole blocks: both halves start on a cache line
        let middle = self.scratch.len() / 2 / LANES * LANES;
        let (scratch, scratch_below) = self.scratch.split_at_mut(middle);
        let above = Forward { to: above, scratch, ..self };
        let below = Forward { to: below, scratch: scratch_below, ..above };
        (above, below)
    }
}

impl<T: Real> Output<'_, T> {
    /// The upper and the lower lines of a single image.
    fn halves(self, conv: &R2Conv) -> (Self, Self) {
        let middle = conv.out.height / 2;
        let pixels = middle * conv.out.width;
        let (y, y_below) = self.y.split(pixels, conv.out.fields.dim());
        let at = pixels * conv.weights.width();
        let (masks, masks_below) = self.masks.map(|masks| masks.split_at_mut(at)).unzip();
        let above = Output { lines: 0..middle, y, masks };
        let below = Output { lines: middle..conv.out.height, y: y_below, masks: masks_below };
        (above, below)
    }
}

//! Window of a convolution or of a pooling layer.

use std::fmt;

/// Square window that slides over an image, padded on all sides; all lengths in pixels.
///
/// Windows sit symmetrically on an axis, and a layer therefore commutes with its flip, if and only
/// if (length + 2 padding - size) mod stride = 0, with the length of the image along the axis.
/// Layers require this of every axis that some element of their group flips. D1x requires it of the
/// width only and C1 of neither axis: there windows start at the left and at the top, and pixels of
/// the remainder are ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SlidingWindow {
    /// Side of the window (pixels).
    pub size: usize,
    /// Distance between neighbouring windows (pixels).
    pub stride: usize,
    /// Width of the padding on each side of the image (pixels): zeros, which a maximum ignores.
    pub padding: usize,
}

impl SlidingWindow {
    /// Creates a window with this side, stride and padding, all in pixels.
    pub const fn new(size: usize, stride: usize, padding: usize) -> SlidingWindow {
        SlidingWindow { size, stride, padding }
    }
}

impl fmt::Display for SlidingWindow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (size, step, padding) = (self.size, self.stride, self.padding);
        write!(f, "{size} x {size} stride {step} padding {padding}")
    }
}

//! The window of a convolution or of a pooling.

use std::fmt;

/// A square window that slides over an image, padded on all sides; all lengths in pixels.
///
/// Windows sit symmetrically on an axis, hence a layer commutes with its flip, if and only if
/// (size + 2 padding - kernel) mod stride = 0. Layers hold every axis to it that some element of
/// their group flips. D1x asks it of the width only and C1 of neither: there windows start at the
/// left and at the top, and a remainder of pixels is not seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Kernel {
    /// Side of the window.
    pub size: usize,
    /// Step between windows.
    pub stride: usize,
    /// Pixels added on each side of the image.
    pub padding: usize,
}

impl Kernel {
    /// A window of this side, step and padding.
    pub const fn new(size: usize, stride: usize, padding: usize) -> Kernel {
        Kernel { size, stride, padding }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (size, step, padding) = (self.size, self.stride, self.padding);
        write!(f, "{size} x {size} stride {step} padding {padding}")
    }
}

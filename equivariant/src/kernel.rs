//! The window of a convolution.

use crate::LayerError;

/// A square window that slides over an image padded with zeros; all lengths in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Kernel {
    /// Side of the window.
    pub size: usize,
    /// Step between windows.
    pub stride: usize,
    /// Zero pixels added on each side of the image.
    pub padding: usize,
}

impl Kernel {
    /// The number of windows along an axis of `size` pixels.
    ///
    /// Windows sit symmetrically on the axis, hence a convolution commutes with flips, if and
    /// only if (size + 2 padding - kernel) mod stride = 0.
    ///
    /// # Errors
    /// When the windows do not sit symmetrically or none fits.
    pub fn out_size(&self, size: usize) -> Result<usize, LayerError> {
        let Kernel {
            size: kernel,
            stride,
            padding,
        } = *self;
        let padded = size + 2 * padding;
        if kernel == 0 || stride == 0 || kernel > padded {
            return Err(LayerError::Window {
                size,
                kernel,
                stride,
                padding,
            });
        }
        match (padded - kernel) % stride {
            0 => Ok((padded - kernel) / stride + 1),
            remainder => Err(LayerError::Inexact {
                size,
                kernel,
                stride,
                padding,
                remainder,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inexact_window_is_refused_with_its_numbers() {
        let kernel = Kernel {
            size: 3,
            stride: 2,
            padding: 1,
        };
        assert_eq!(kernel.out_size(5), Ok(3));
        let message = kernel.out_size(48).unwrap_err().to_string();
        assert!(
            message.contains("got (48 + 2 * 1 - 3) mod 2 = 1, expected 0"),
            "{message}"
        );
    }

    #[test]
    fn a_window_that_does_not_fit_is_refused() {
        let kernel = |size, stride| Kernel {
            size,
            stride,
            padding: 0,
        };
        let message = kernel(4, 1).out_size(3).unwrap_err().to_string();
        assert!(message.contains("got a 4 x 4 kernel"), "{message}");
        assert!(kernel(0, 1).out_size(3).is_err());
        assert!(kernel(3, 0).out_size(3).is_err());
        assert_eq!(kernel(3, 1).out_size(3), Ok(1));
    }
}

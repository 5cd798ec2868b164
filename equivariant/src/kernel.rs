//! The window of a convolution or of a pooling.

use std::fmt;

use symmetry::Group;

use crate::LayerError;

/// A square window that slides over an image, padded on all sides; all lengths in pixels.
///
/// Windows sit symmetrically on an axis, hence a layer commutes with its flip, if and only if
/// (size + 2 padding - kernel) mod stride = 0. Layers hold every axis to it that some element of
/// their group flips; D1x asks it of the width only and C1 of neither, where windows start at the left and
/// at the top and a remainder of pixels is not seen.
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
    /// The number of windows along the axes of a `[height, width]` image.
    pub(crate) fn windows(
        self,
        layer: &'static str,
        group: Group,
        [height, width]: [usize; 2],
    ) -> Result<[usize; 2], LayerError> {
        Ok([
            self.along(layer, group, ("height", height), group.flips_y())?,
            self.along(layer, group, ("width", width), group.flips_x())?,
        ])
    }

    fn along(
        self,
        layer: &'static str,
        group: Group,
        (axis, size): (&'static str, usize),
        flipped: bool,
    ) -> Result<usize, LayerError> {
        let padded = size + 2 * self.padding;
        if self.size == 0 || self.stride == 0 || self.size > padded {
            return Err(LayerError::Window {
                layer,
                axis,
                size,
                kernel: self,
            });
        }
        let remainder = (padded - self.size) % self.stride;
        if flipped && remainder != 0 {
            return Err(LayerError::Inexact {
                layer,
                group,
                axis,
                size,
                kernel: self,
                remainder,
            });
        }
        Ok((padded - self.size) / self.stride + 1)
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Kernel {
            size,
            stride,
            padding,
        } = self;
        write!(f, "{size} x {size} stride {stride} padding {padding}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(group: Group, [size, stride, padding]: [usize; 3], image: [usize; 2]) -> [usize; 2] {
        let kernel = Kernel {
            size,
            stride,
            padding,
        };
        kernel.windows("R2Conv", group, image).unwrap_or_default()
    }

    #[test]
    fn an_inexact_window_is_refused_with_its_numbers() {
        let kernel = Kernel {
            size: 3,
            stride: 2,
            padding: 1,
        };
        assert_eq!(kernel.windows("R2Conv", Group::D2, [5, 7]), Ok([3, 4]));
        let error = kernel.windows("R2Conv", Group::C2, [5, 48]).unwrap_err();
        let message = error.to_string();
        assert!(
            message.starts_with("R2Conv: C2 flips the width"),
            "{message}"
        );
        assert!(
            message.contains("got (48 + 2 * 1 - 3) mod 2 = 1, expected 0"),
            "{message}"
        );
    }

    #[test]
    fn only_axes_that_the_group_flips_must_be_exact() {
        let inexact = [[5, 6], [6, 5], [6, 6]];
        let count = |group| inexact.map(|image| windows(group, [3, 2, 1], image));
        assert_eq!(count(Group::C1), [[3, 3]; 3]);
        assert_eq!(count(Group::D1x), [[0, 0], [3, 3], [0, 0]]);
        assert_eq!(count(Group::D1y), [[3, 3], [0, 0], [0, 0]]);
        assert_eq!(count(Group::C2), [[0, 0]; 3]);
        assert_eq!(count(Group::D2), [[0, 0]; 3]);
    }

    #[test]
    fn a_window_that_does_not_fit_is_refused() {
        let kernel = |size, stride| Kernel {
            size,
            stride,
            padding: 0,
        };
        let windows = |kernel: Kernel| kernel.windows("R2Conv", Group::C1, [9, 3]);
        let message = windows(kernel(4, 1)).unwrap_err().to_string();
        assert!(message.contains("got a window of 4 pixels"), "{message}");
        assert!(message.contains("on the width of 3"), "{message}");
        assert!(windows(kernel(0, 1)).is_err());
        assert!(windows(kernel(3, 0)).is_err());
        assert_eq!(windows(kernel(3, 1)), Ok([7, 1]));
    }
}

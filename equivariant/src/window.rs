//! The pixels that a pooling window sees.

use symmetry::Group;

use crate::{Kernel, LayerError};

/// Where the windows of a pooling lie on an image; padding is no pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    pub kernel: Kernel,
    in_size: [usize; 2],
    pub out_size: [usize; 2],
}

impl Windows {
    pub fn new(
        layer: &'static str,
        group: Group,
        kernel: Kernel,
        in_size: [usize; 2],
    ) -> Result<Windows, LayerError> {
        let out_size = kernel.windows(layer, group, in_size)?;
        if 2 * kernel.padding > kernel.size {
            return Err(LayerError::Padding {
                layer,
                padding: kernel.padding,
                size: kernel.size,
            });
        }
        Ok(Windows {
            kernel,
            in_size,
            out_size,
        })
    }

    /// The indices of the pixels that output pixel `index` sees, row-major; there is at least one.
    pub fn pixels(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let [_, out_width] = self.out_size;
        let [height, width] = self.in_size;
        let along = |at: usize, size: usize| {
            let Kernel {
                size: window,
                stride,
                padding,
            } = self.kernel;
            let start = at * stride;
            start.saturating_sub(padding)..(start + window - padding).min(size)
        };
        let (rows, cols) = (
            along(index / out_width, height),
            along(index % out_width, width),
        );
        rows.flat_map(move |row| cols.clone().map(move |col| row * width + col))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_cut_at_the_border() {
        let kernel = Kernel {
            size: 3,
            stride: 2,
            padding: 1,
        };
        let windows = Windows::new("MaxPool", Group::D2, kernel, [3, 5]).unwrap();
        assert_eq!(windows.out_size, [2, 3]);
        let pixels = |index| windows.pixels(index).collect::<Vec<_>>();
        assert_eq!(pixels(0), [0, 1, 5, 6]);
        assert_eq!(pixels(4), [6, 7, 8, 11, 12, 13]);
    }

    #[test]
    fn windows_of_padding_alone_are_refused() {
        let kernel = Kernel {
            size: 2,
            stride: 2,
            padding: 2,
        };
        let error = Windows::new("MaxPool", Group::D2, kernel, [4, 4]).unwrap_err();
        let expected = "MaxPool: got a padding of 2 for a window of 2, expected at most 2 / 2";
        assert_eq!(error.to_string(), expected);
    }
}

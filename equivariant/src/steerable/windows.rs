//! Positions of sliding windows on an image.

use std::fmt;

use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::shape::Shape;
use crate::window::SlidingWindow;

/// Grid of the sliding windows of a convolution or of a pooling layer on an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowGrid {
    pub kernel: SlidingWindow,
    in_size: [usize; 2],
    pub out_size: [usize; 2],
}

impl WindowGrid {
    /// Creates the grid of windows on a `[height, width]` image. The windows must sit symmetrically
    /// on the axes that the group flips.
    pub fn new(
        layer: &'static str,
        group: Group,
        kernel: SlidingWindow,
        in_size: [usize; 2],
    ) -> Result<WindowGrid, LayerError> {
        let [height, width] = in_size;
        let axes = [
            ("height", height, group.has_element_flipping_y()),
            ("width", width, group.has_element_flipping_x()),
        ];
        let [rows, columns] = axes.map(|(axis, size, flipped)| {
            along(layer, kernel, axis, size, flipped.then_some(group))
        });
        Ok(WindowGrid { kernel, in_size, out_size: [rows?, columns?] })
    }

    /// Creates the grid of windows of a pooling layer, none of which may lie entirely in the
    /// padding.
    pub fn for_pooling(
        layer: &'static str,
        shape: Shape,
        kernel: SlidingWindow,
    ) -> Result<WindowGrid, LayerError> {
        LayerError::check_map(layer, shape, kernel.padding)?;
        let in_size = [shape.height, shape.width];
        let windows = WindowGrid::new(layer, shape.fields.group(), kernel, in_size)?;
        if kernel.padding > kernel.size / 2 {
            return Err(LayerError::InvalidSetting {
                layer,
                setting: "padding",
                got: format!("{} of a window of {} pixels", kernel.padding, kernel.size),
                expected: "at most half of the window, which would lie in the padding otherwise",
            });
        }
        Ok(windows)
    }

    /// Returns the shape of a feature map with a pixel for every window.
    pub fn out_shape(&self, fields: FieldType) -> Shape {
        let [height, width] = self.out_size;
        Shape::image(height, width, fields)
    }

    /// Writes the description of a pooling layer: name, shapes and window.
    pub fn fmt_pooling(
        &self,
        f: &mut fmt::Formatter<'_>,
        name: &str,
        fields: FieldType,
    ) -> fmt::Result {
        let [height, width] = self.in_size;
        let (from, to) = (Shape::image(height, width, fields), self.out_shape(fields));
        write!(f, "{name}({from} -> {to}, {})", self.kernel)
    }

    /// Iterates over the indices of the pixels in the window of output pixel `index`, row-major and
    /// without padding.
    pub fn pixels_in_window(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let [_, out_width] = self.out_size;
        let [height, width] = self.in_size;
        let along = |at: usize, size: usize| {
            let SlidingWindow { size: window, stride, padding } = self.kernel;
            let start = at * stride;
            start.saturating_sub(padding)..(start + window - padding).min(size)
        };
        let (rows, cols) = (along(index / out_width, height), along(index % out_width, width));
        rows.flat_map(move |row| cols.clone().map(move |col| row * width + col))
    }
}

/// Returns the number of windows along an axis; `flipped` is the group if it flips the axis.
fn along(
    layer: &'static str,
    kernel: SlidingWindow,
    axis: &'static str,
    size: usize,
    flipped: Option<Group>,
) -> Result<usize, LayerError> {
    // settings come from the caller, so sums of them may overflow
    let padding = kernel.padding.checked_mul(2);
    let padded = padding.and_then(|padding| padding.checked_add(size));
    let room = padded.and_then(|padded| padded.checked_sub(kernel.size));
    let (Some(room), 1.., 1..) = (room, kernel.size, kernel.stride) else {
        return Err(LayerError::InvalidWindow { layer, axis, size, kernel });
    };
    let remainder = room % kernel.stride;
    match flipped {
        Some(group) if remainder != 0 => {
            Err(LayerError::AsymmetricWindow { layer, group, axis, size, kernel, remainder })
        }
        _ => Ok(room / kernel.stride + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(height: usize, width: usize) -> Shape {
        Shape::image(height, width, Group::D2.trivial_type(1))
    }

    fn windows(group: Group, window: [usize; 3], image: [usize; 2]) -> Result<[usize; 2], String> {
        let [size, stride, padding] = window;
        let windows =
            WindowGrid::new("R2Conv", group, SlidingWindow::new(size, stride, padding), image);
        windows.map(|windows| windows.out_size).map_err(|error| error.to_string())
    }

    #[test]
    fn an_inexact_window_is_refused_with_its_numbers() {
        assert_eq!(windows(Group::D2, [3, 2, 1], [5, 7]), Ok([3, 4]));
        let message = windows(Group::C2, [3, 2, 1], [5, 48]).unwrap_err();
        assert!(message.starts_with("R2Conv: C2 flips the width"), "{message}");
        assert!(message.contains("got (48 + 2 * 1 - 3) mod 2 = 1, expected 0"), "{message}");
    }

    #[test]
    fn only_axes_that_the_group_flips_must_be_exact() {
        let inexact = [[5, 6], [6, 5], [6, 6]];
        let fits = |group| inexact.map(|image| windows(group, [3, 2, 1], image).is_ok());
        assert_eq!(windows(Group::C1, [3, 2, 1], [6, 6]), Ok([3, 3]));
        assert_eq!(fits(Group::C1), [true; 3]);
        assert_eq!(fits(Group::D1x), [false, true, false]);
        assert_eq!(fits(Group::D1y), [true, false, false]);
        assert_eq!(fits(Group::C2), [false; 3]);
        assert_eq!(fits(Group::D2), [false; 3]);
    }

    #[test]
    fn a_window_that_does_not_fit_is_refused() {
        let on = |size, stride| windows(Group::C1, [size, stride, 0], [9, 3]);
        let message = on(4, 1).unwrap_err();
        assert!(message.contains("got a window of 4 pixels"), "{message}");
        assert!(message.contains("on the width of 3"), "{message}");
        assert!(on(0, 1).is_err());
        assert!(on(3, 0).is_err());
        assert_eq!(on(3, 1), Ok([7, 1]));
    }

    #[test]
    fn windows_are_cut_at_the_border() {
        let windows =
            WindowGrid::new("MaxPool", Group::D2, SlidingWindow::new(3, 2, 1), [3, 5]).unwrap();
        assert_eq!(windows.out_size, [2, 3]);
        let pixels = |index| windows.pixels_in_window(index).collect::<Vec<_>>();
        assert_eq!(pixels(0), [0, 1, 5, 6]);
        assert_eq!(pixels(4), [6, 7, 8, 11, 12, 13]);
    }

    #[test]
    fn pools_of_padding_alone_are_refused() {
        let window = SlidingWindow::new(2, 2, 2);
        let error = WindowGrid::for_pooling("MaxPool", image(4, 6), window).unwrap_err();
        let expected = "MaxPool: got the padding 2 of a window of 2 pixels, expected at most half";
        assert!(error.to_string().starts_with(expected), "{error}");
    }
}

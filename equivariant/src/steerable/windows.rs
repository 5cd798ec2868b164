//! Positions of sliding windows on an image.

use std::fmt;

use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::shape::Shape;
use crate::window::SlidingWindow;

/// Grid of the sliding windows of a convolution or of a pooling layer on an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindowGrid {
    pub window: SlidingWindow,
    in_size: [usize; 2],
    pub out_size: [usize; 2],
}

impl WindowGrid {
    /// Creates the grid of windows on a `[height, width]` image. The windows must sit symmetrically
    /// on the axes that the group flips.
    pub fn new(
        layer: &'static str,
        group: Group,
        window: SlidingWindow,
        in_size: [usize; 2],
    ) -> Result<WindowGrid, LayerError> {
        let [height, width] = in_size;
        let axes = [
            ("height", height, group.has_element_flipping_y()),
            ("width", width, group.has_element_flipping_x()),
        ];
        let [rows, columns] = axes.map(|(axis, size, flipped)| {
            num_windows(layer, window, axis, size, flipped.then_some(group))
        });
        Ok(WindowGrid { window, in_size, out_size: [rows?, columns?] })
    }

    /// Creates the grid of windows of a pooling layer, none of which may lie entirely in the
    /// padding.
    pub fn for_pooling(
        layer: &'static str,
        shape: Shape,
        window: SlidingWindow,
    ) -> Result<WindowGrid, LayerError> {
        LayerError::check_feature_map_size(layer, shape, window.padding)?;
        let in_size = [shape.height, shape.width];
        let windows = WindowGrid::new(layer, shape.fields.group(), window, in_size)?;
        if window.padding > window.size / 2 {
            return Err(LayerError::InvalidSetting {
                layer,
                setting: "padding",
                got: format!("{} of a window of {} pixels", window.padding, window.size),
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
        write!(f, "{name}({from} -> {to}, {})", self.window)
    }

    /// Iterates over the indices of the pixels in the window of output pixel `index`, row-major and
    /// without padding.
    pub fn pixels_in_window(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let [_, out_width] = self.out_size;
        let [height, width] = self.in_size;
        let along = |at: usize, size: usize| {
            let SlidingWindow { size: window, stride, padding } = self.window;
            let start = at * stride;
            start.saturating_sub(padding)..(start + window - padding).min(size)
        };
        let (rows, cols) = (along(index / out_width, height), along(index % out_width, width));
        rows.flat_map(move |row| cols.clone().map(move |col| row * width + col))
    }
}

/// Returns the number of windows along an axis; `flipped` is the group if it flips the axis.
fn num_windows(
    layer: &'static str,
    window: SlidingWindow,
    axis: &'static str,
    size: usize,
    flipped: Option<Group>,
) -> Result<usize, LayerError> {
    // settings come from the caller, so sums of them may overflow
    let padding = window.padding.checked_mul(2);
    let padded = padding.and_then(|padding| padding.checked_add(size));
    let room = padded.and_then(|padded| padded.checked_sub(window.size));
    let (Some(room), 1.., 1..) = (room, window.size, window.stride) else {
        return Err(LayerError::InvalidWindow { layer, axis, size, window });
    };
    let remainder = room % window.stride;
    match flipped {
        Some(group) if remainder != 0 => {
            Err(LayerError::AsymmetricWindow { layer, group, axis, size, window, remainder })
        }
        _ => Ok(room / window.stride + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pools_of_padding_alone_are_refused() {
        let window = SlidingWindow::new(2, 2, 2);
        let image = Shape::image(4, 6, Group::D2.trivial_type(1));
        let error = WindowGrid::for_pooling("MaxPool", image, window).unwrap_err();
        let expected = "MaxPool: got the padding 2 of a window of 2 pixels, expected at most half";
        assert!(error.to_string().starts_with(expected), "{error}");
    }
}

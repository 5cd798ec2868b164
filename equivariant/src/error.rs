//! Why a layer cannot be built.

use symmetry::{FieldType, Group};
use thiserror::Error;

use crate::shape::{LARGEST, Shape};
use crate::window::Kernel;

/// A layer that would not be exact, or does not fit its neighbours.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LayerError {
    /// A strided window does not sit symmetrically on an axis that the group flips.
    #[error(
        "{layer}: {group} flips the {axis}, and a window of {k} pixels, stride {s} and padding {p} leaves a \
         remainder there: got ({size} + 2 * {p} - {k}) mod {s} = {remainder}, expected 0; change size, padding, \
         kernel or stride so that the flip stays exact",
        k = kernel.size, s = kernel.stride, p = kernel.padding
    )]
    Inexact {
        /// Name of the layer.
        layer: &'static str,
        /// The group of its types.
        group: Group,
        /// `height` or `width`.
        axis: &'static str,
        /// The input's length along it in pixels.
        size: usize,
        /// The window.
        kernel: Kernel,
        /// Remainder of the division.
        remainder: usize,
    },
    /// The window does not fit the padded image, or a size or stride is zero.
    #[error(
        "{layer}: got a window of {k} pixels, stride {s} and padding {p} on the {axis} of {size}, \
         expected 1 <= {k} <= {size} + 2 * {p} and a stride of at least 1",
        k = kernel.size, s = kernel.stride, p = kernel.padding
    )]
    Window {
        /// Name of the layer.
        layer: &'static str,
        /// `height` or `width`.
        axis: &'static str,
        /// The input's length along it in pixels.
        size: usize,
        /// The window.
        kernel: Kernel,
    },
    /// A layer was given a type that it is not equivariant on.
    #[error("{layer}: got the type `{got}`, expected {expected}")]
    Type {
        /// Name of the layer.
        layer: &'static str,
        /// The refused type.
        got: FieldType,
        /// Description of accepted values.
        expected: &'static str,
    },
    /// Two types of one layer belong to different groups.
    #[error(
        "{layer}: got the types `{first}` of {} and `{second}` of {}, expected one group; restrict one of them",
        first.group(), second.group()
    )]
    Groups {
        /// Name of the layer.
        layer: &'static str,
        /// One type.
        first: FieldType,
        /// The other.
        second: FieldType,
    },
    /// A window can lie in the padding altogether, where nothing can be pooled.
    #[error(
        "{layer}: got a padding of {padding} for a window of {size}, expected at most {size} / 2"
    )]
    Padding {
        /// Name of the layer.
        layer: &'static str,
        /// Pixels added on each side.
        padding: usize,
        /// Side of the window in pixels.
        size: usize,
    },
    /// A map without channels or pixels, in which there is nothing to compute.
    #[error("{layer}: got a map of {shape}, expected at least one pixel and one channel")]
    EmptyMap {
        /// Name of the layer.
        layer: &'static str,
        /// The refused shape.
        shape: Shape,
    },
    /// Sizes whose product no memory holds.
    #[error(
        "{layer}: got {what} of more than {LARGEST} values, expected at most that; lower sizes, channels or padding"
    )]
    TooLarge {
        /// Name of the layer.
        layer: &'static str,
        /// Name of the thing that is too large.
        what: &'static str,
    },
    /// A layer that needs a square map was given another one.
    #[error("{layer}: got a map of {height} x {width} pixels, expected a square one")]
    NotSquare {
        /// Name of the layer.
        layer: &'static str,
        /// Rows of pixels.
        height: usize,
        /// Columns of pixels.
        width: usize,
    },
    /// Two maps that belong together have different sizes.
    #[error(
        "{layer}: got maps of {} x {} and {} x {} pixels, expected equal heights and widths",
        first[0], first[1], second[0], second[1]
    )]
    Sizes {
        /// Name of the layer.
        layer: &'static str,
        /// Height and width of one map in pixels.
        first: [usize; 2],
        /// Height and width of the other.
        second: [usize; 2],
    },
    /// A number of the layer's settings is out of its range.
    #[error("{layer}: got the {setting} {got}, expected {expected}")]
    Setting {
        /// Name of the layer.
        layer: &'static str,
        /// Name of the setting.
        setting: &'static str,
        /// The refused value.
        got: String,
        /// Description of accepted values.
        expected: &'static str,
    },
    /// Neighbouring layers of a sequence disagree.
    #[error(
        "Sequential: layer {index} takes {takes}, but layer {previous} gives {gives}; make the shapes equal",
        previous = index - 1
    )]
    Mismatch {
        /// Position of the second of the two layers.
        index: usize,
        /// Its input.
        takes: Shape,
        /// The output of the layer before it.
        gives: Shape,
    },
    /// A sequence has no layers.
    #[error("Sequential: got 0 layers, expected at least 1")]
    Empty,
}

impl LayerError {
    /// Refuses types of different groups.
    pub(crate) fn check_groups(
        layer: &'static str,
        first: FieldType,
        second: FieldType,
    ) -> Result<(), LayerError> {
        if first.group() == second.group() {
            return Ok(());
        }
        Err(LayerError::Groups { layer, first, second })
    }

    /// Refuses more output channels than a field type can have.
    pub(crate) fn check_channels(layer: &'static str, channels: usize) -> Result<(), LayerError> {
        if channels <= FieldType::MAX_DIM {
            return Ok(());
        }
        Err(LayerError::Setting {
            layer,
            setting: "number of output channels",
            got: channels.to_string(),
            expected: "at most 16777216, the most of a field type; lower those of the input",
        })
    }

    /// Refuses maps without values, and those that no memory holds with `padding` on all sides.
    ///
    /// `layer` is the name that the error gives and `padding` is in pixels on each side.
    ///
    /// # Errors
    /// [`EmptyMap`](LayerError::EmptyMap) and [`TooLarge`](LayerError::TooLarge).
    pub fn check_map(layer: &'static str, shape: Shape, padding: usize) -> Result<(), LayerError> {
        match shape.padded_len(padding) {
            None => Err(LayerError::TooLarge { layer, what: "a map" }),
            Some(_) if shape.is_empty() => Err(LayerError::EmptyMap { layer, shape }),
            Some(_) => Ok(()),
        }
    }
}

//! Errors of the layers' constructors.

use symmetry::{FieldType, Group};
use thiserror::Error;

use crate::shape::{MAX_VALUES, Shape};
use crate::window::SlidingWindow;

/// Reason why a layer cannot be built.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LayerError {
    /// Strided window that does not sit symmetrically on an axis that the group flips.
    #[error(
        "{layer}: {group} flips the {axis}, and a window of {k} pixels, stride {s} and padding {p} leaves a \
         remainder there: got ({size} + 2 * {p} - {k}) mod {s} = {remainder}, expected 0; change size, padding, \
         kernel or stride so that the flip stays exact",
        k = window.size, s = window.stride, p = window.padding
    )]
    AsymmetricWindow {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Symmetry group of the layer's field types.
        group: Group,
        /// Axis of the image that the group flips, `height` or `width`.
        axis: &'static str,
        /// Length of the input image along the axis, in pixels.
        size: usize,
        /// Window that does not sit symmetrically on the axis.
        window: SlidingWindow,
        /// Remainder of (image length + 2 padding - window size) divided by the stride, in pixels;
        /// must be 0.
        remainder: usize,
    },
    /// Window that does not fit the padded image, or whose size or stride is zero.
    #[error(
        "{layer}: got a window of {k} pixels, stride {s} and padding {p} on the {axis} of {size}, \
         expected 1 <= {k} <= {size} + 2 * {p} and a stride of at least 1",
        k = window.size, s = window.stride, p = window.padding
    )]
    InvalidWindow {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Axis of the image along which the window is rejected, `height` or `width`.
        axis: &'static str,
        /// Length of the input image along the axis, in pixels.
        size: usize,
        /// Window that is larger than the padded image, or whose size or stride is zero.
        window: SlidingWindow,
    },
    /// Field type on which the layer would not be equivariant.
    #[error("{layer}: got the type `{got}`, expected {expected}")]
    InvalidFieldType {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Field type that the layer does not accept.
        got: FieldType,
        /// Description of the field types that the layer accepts.
        expected: &'static str,
    },
    /// Two field types of one layer that belong to different symmetry groups.
    #[error(
        "{layer}: got the types `{first}` of {} and `{second}` of {}, expected one group; restrict one of them",
        first.group(), second.group()
    )]
    DifferentGroups {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// First of the two field types whose groups differ.
        first: FieldType,
        /// Second of the two field types whose groups differ.
        second: FieldType,
    },
    /// Feature map without channels or pixels.
    #[error("{layer}: got a map of {shape}, expected at least one pixel and one channel")]
    EmptyMap {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Shape of the feature map without channels or pixels.
        shape: Shape,
    },
    /// Map, matrix or kernel of more values than the limit of 2^31.
    #[error(
        "{layer}: got {what} of more than {MAX_VALUES} values, expected at most that; lower sizes, channels or padding"
    )]
    TooManyValues {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Description of the object that is too large, such as `a map`.
        what: &'static str,
    },
    /// Setting of the layer that is out of its range, or that does not fit the others.
    #[error("{layer}: got the {setting} {got}, expected {expected}")]
    InvalidSetting {
        /// Name of the layer that cannot be built.
        layer: &'static str,
        /// Name of the setting that is out of its range.
        setting: &'static str,
        /// Value of the setting that is out of its range, as text.
        got: String,
        /// Description of the accepted values of the setting.
        expected: &'static str,
    },
    /// Neighbouring layers of a sequence with different shapes between them.
    #[error(
        "Sequential: layer {index} takes {takes}, but layer {previous} gives {gives}; make the shapes equal",
        previous = index - 1
    )]
    ShapeMismatch {
        /// Position of the second of the two layers in the sequence, from 0.
        index: usize,
        /// Shape of the input that the second of the two layers takes.
        takes: Shape,
        /// Shape of the output that the first of the two layers gives.
        gives: Shape,
    },
}

impl LayerError {
    /// Returns [`DifferentGroups`](LayerError::DifferentGroups) if two types belong to different
    /// groups.
    pub(crate) fn check_groups(
        layer: &'static str,
        first: FieldType,
        second: FieldType,
    ) -> Result<(), LayerError> {
        if first.group() == second.group() {
            return Ok(());
        }
        Err(LayerError::DifferentGroups { layer, first, second })
    }

    /// Returns [`InvalidSetting`](LayerError::InvalidSetting) for more output channels than a field
    /// type can have.
    pub(crate) fn check_channels(layer: &'static str, channels: usize) -> Result<(), LayerError> {
        if channels <= FieldType::MAX_DIM {
            return Ok(());
        }
        Err(LayerError::InvalidSetting {
            layer,
            setting: "number of output channels",
            got: channels.to_string(),
            expected: "at most 16777216, the most of a field type; lower those of the input",
        })
    }

    /// Checks that a feature map has channels and pixels and, with padding, at most 2^31 values.
    ///
    /// `layer` is the name in the error and `padding` is in pixels on each side.
    ///
    /// # Errors
    /// [`EmptyMap`](LayerError::EmptyMap) and [`TooManyValues`](LayerError::TooManyValues).
    pub fn check_feature_map_size(
        layer: &'static str,
        shape: Shape,
        padding: usize,
    ) -> Result<(), LayerError> {
        match shape.padded_len(padding) {
            None => Err(LayerError::TooManyValues { layer, what: "a map" }),
            Some(_) if shape.is_empty() => Err(LayerError::EmptyMap { layer, shape }),
            Some(_) => Ok(()),
        }
    }
}

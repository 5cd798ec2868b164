//! Why a layer cannot be built.

use thiserror::Error;

use crate::{FieldType, Shape};

/// A layer that would not be exact, or does not fit its neighbours.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LayerError {
    /// A strided window does not sit symmetrically on the image, so flips would not commute with it.
    #[error(
        "a {kernel} x {kernel} kernel of stride {stride} and padding {padding} on {size} pixels \
         leaves a remainder: got ({size} + 2 * {padding} - {kernel}) mod {stride} = {remainder}, \
         expected 0; change size, padding, kernel or stride so that flips stay exact"
    )]
    Inexact {
        /// Height or width of the input in pixels.
        size: usize,
        /// Side of the kernel in pixels.
        kernel: usize,
        /// Step between windows in pixels.
        stride: usize,
        /// Zero pixels added on each side.
        padding: usize,
        /// What the division leaves.
        remainder: usize,
    },
    /// The kernel does not fit the padded image, or a size or stride is zero.
    #[error(
        "got a {kernel} x {kernel} kernel of stride {stride} on {size} pixels padded by {padding}, \
         expected 1 <= kernel <= {size} + 2 * {padding} and stride >= 1"
    )]
    Window {
        /// Height or width of the input in pixels.
        size: usize,
        /// Side of the kernel in pixels.
        kernel: usize,
        /// Step between windows in pixels.
        stride: usize,
        /// Zero pixels added on each side.
        padding: usize,
    },
    /// A pointwise layer was given a type it is not equivariant on.
    #[error("{layer} got the type `{got}`, expected {expected}")]
    Type {
        /// Name of the layer.
        layer: &'static str,
        /// The refused type.
        got: FieldType,
        /// What the layer takes.
        expected: &'static str,
    },
    /// Neighbouring layers of a sequence disagree.
    #[error(
        "layer {index} takes {takes}, but layer {previous} gives {gives}; make the shapes equal",
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
    #[error("got 0 layers, expected at least 1")]
    Empty,
}

//! What types of fields a layer takes.

use symmetry::FieldType;

use crate::error::LayerError;
use crate::shape::Shape;
use crate::steerable::hadamard::permuted;

/// The order of the group and the number of fields of a map that has a basis which the group
/// permutes.
pub(crate) fn permuted_fields(
    layer: &'static str,
    shape: Shape,
) -> Result<(usize, usize), LayerError> {
    LayerError::check_map(layer, shape, 0)?;
    permuted(shape.fields).ok_or(LayerError::Type {
        layer,
        got: shape.fields,
        expected: "regular fields only or trivial channels only",
    })
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

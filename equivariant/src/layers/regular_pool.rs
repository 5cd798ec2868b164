//! What layers that pool over the group have in common.

use crate::error::LayerError;
use crate::shape::Shape;

/// Maps of regular fields, and how many they have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RegularMaps {
    pub shape: Shape,
    pub fields: usize,
}

impl RegularMaps {
    /// Refuses every other type.
    pub fn new(layer: &'static str, shape: Shape) -> Result<RegularMaps, LayerError> {
        LayerError::check_map(layer, shape, 0)?;
        let fields = shape.fields.regular_fields().ok_or(LayerError::Type {
            layer,
            got: shape.fields,
            expected: "regular fields only",
        })?;
        Ok(RegularMaps { shape, fields })
    }

    /// Maps with a trivial channel for each field.
    pub fn pooled(&self) -> Shape {
        let fields = self.shape.fields.group().trivial(self.fields);
        Shape {
            fields,
            ..self.shape
        }
    }
}

/// Makes a layer of a struct around [`RegularMaps`] that leaves one number of each field.
macro_rules! pooled_over_the_group {
    ($Pool:ident) => {
        impl $Pool {
            /// The pooling of maps of this shape.
            ///
            /// # Errors
            /// When the map is empty or its type is not regular fields only.
            pub fn new(shape: $crate::shape::Shape) -> Result<$Pool, $crate::error::LayerError> {
                RegularMaps::new(stringify!($Pool), shape).map($Pool)
            }
        }

        impl $crate::layers::layer::Signature for $Pool {
            fn in_shape(&self) -> $crate::shape::Shape {
                self.0.shape
            }

            fn out_shape(&self) -> $crate::shape::Shape {
                self.0.pooled()
            }

            #[cfg(feature = "wgpu")]
            fn operation(&self) -> Option<$crate::steerable::operation::Operation<'_>> {
                Some($crate::steerable::operation::Operation::$Pool)
            }
        }

        impl std::fmt::Display for $Pool {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, concat!(stringify!($Pool), "({})"), self.0.shape)
            }
        }
    };
}

pub(crate) use pooled_over_the_group;

//! Layers of networks.

mod average_pool;
mod check;
mod concat;
pub(crate) mod field_norm;
mod group_pool;
mod gru;
mod interchange;
pub(crate) mod layer;
mod linear;
mod max_pool;
mod r2_conv;
mod relu;
mod restrict;
mod sequential;
mod soft_argmax;
mod sum;

pub use check::{Example, equivariance_error, equivariance_error_of, unit_sums};
pub use concat::Concat;
pub use gru::{Gru, GruPass};
pub use interchange::{InterchangeError, load, save};
pub use layer::{Layer, LayerKind, Scalar, Signature, Statistics};
pub use sequential::Sequential;

/// Exports the layers of each file and collects their examples.
macro_rules! registry {
    ($($module:ident: $($Layer:ident)+,)+) => {
        $(pub use $module::{$($Layer),+};)+

        /// Returns examples of every layer for a group, for tests of code that runs layers.
        ///
        /// # Errors
        /// Errors of the layers' constructors; none for the groups of this crate.
        pub fn examples<T: Scalar>(
            group: symmetry::Group,
        ) -> Result<Vec<Example<T>>, crate::error::LayerError> {
            let all = [$($module::examples(group)?),+];
            Ok(all.into_iter().flatten().collect())
        }
    };
}

registry! {
    average_pool: AveragePool,
    field_norm: FieldNorm,
    group_pool: GroupMaxPool GroupMeanPool,
    linear: Linear,
    max_pool: MaxPool,
    r2_conv: R2Conv,
    relu: Relu,
    restrict: Restrict,
    soft_argmax: SpatialSoftArgmax,
    sum: Sum,
}

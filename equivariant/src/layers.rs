//! Layers of equivariant networks.

mod check;
mod concat;
mod fused_chain;
mod group_pool;
mod gru;
pub(crate) mod layer;
mod linear;
mod max_pool;
mod r2_conv;
mod relu;
mod restrict;
mod sequential;
mod sum;

pub use check::{
    TestLayer, absolute_activation_sums, equivariance_error, equivariance_error_of_fn,
};
pub use concat::Concat;
pub use gru::{Gru, GruWorkspace};
pub use layer::{Layer, LayerKind, LayerSignature, Scalar};
pub use sequential::Sequential;

/// Exports the layers of each file and collects their test layers.
macro_rules! registry {
    ($($module:ident: $Layer:ident,)+) => {
        $(pub use $module::$Layer;)+

        /// Returns test layers of every kind for a group, for tests of code that runs layers.
        ///
        /// # Errors
        /// Errors of the layers' constructors; none for the groups of this crate.
        pub fn test_layers<T: Scalar>(
            group: symmetry::Group,
        ) -> Result<Vec<TestLayer<T>>, crate::error::LayerError> {
            let all = [$($module::test_layers(group)?),+];
            Ok(all.into_iter().flatten().collect())
        }
    };
}

registry! {
    group_pool: GroupMaxPool,
    linear: Linear,
    max_pool: MaxPool,
    r2_conv: R2Conv,
    relu: Relu,
    restrict: Restrict,
    sum: BranchSum,
}

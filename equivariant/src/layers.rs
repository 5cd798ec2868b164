//! What networks are built from.

mod accepted;
pub(crate) mod average_pool;
pub(crate) mod check;
pub(crate) mod concat;
pub(crate) mod field_norm;
mod fused;
pub(crate) mod group_max_pool;
pub(crate) mod group_mean_pool;
pub(crate) mod gru;
pub(crate) mod gru_pass;
pub(crate) mod interchange;
pub(crate) mod layer;
pub(crate) mod linear;
pub(crate) mod max_pool;
mod parameterless;
pub(crate) mod r2_conv;
mod regular_pool;
pub(crate) mod relu;
pub(crate) mod scalar;
pub(crate) mod sequential;
pub(crate) mod soft_argmax;
pub(crate) mod units;

//! Convolutions on the kernels of [`simd`](crate::simd), one by one and in chains.

pub(crate) mod backward;
pub(crate) mod chain;
pub(crate) mod finish;
pub(crate) mod first_layer;
pub(crate) mod forward;
pub(crate) mod geometry;
pub(crate) mod line;
pub(crate) mod load;
pub(crate) mod maps;
pub(crate) mod pass;
pub(crate) mod passes;
pub(crate) mod pieces;
pub(crate) mod pool;
pub(crate) mod weights;

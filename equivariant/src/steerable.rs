//! The mathematics of steerable kernels on the pixel grid, without any thought of speed.

pub(crate) mod blocks;
pub(crate) mod dense;
pub(crate) mod hadamard;
#[cfg(feature = "wgpu")]
pub(crate) mod operation;
pub(crate) mod taps;
pub(crate) mod windows;

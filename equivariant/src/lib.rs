//! Layers that are equivariant under D2 or a subgroup, with explicit forward and backward passes.
//!
//! A layer maps a feature map of one [`FieldType`] to another of the same [`Group`] and commutes
//! with it: f(g x) = g f(x) for every element g. The group is a value: C1 gives ordinary layers.
//! Features live in the irrep basis, where an equivariant linear map is block-diagonal (Schur's
//! lemma), so the entries of the blocks are the parameters and nothing is expanded.
//!
//! - Layers own no weights. The parameters of a network are one flat slice, in the order of its
//!   layers; gradients have the same layout.
//! - Feature maps are `[N, H, W, C]`, channels last, channels irrep-major
//!   ([`FieldType::channel_range`]); vectors are maps of height and width 1.
//! - There is no tape: [`Layer::backward`] takes the same slices as [`Layer::forward`] and the
//!   [`Scratch`] that it filled. All buffers belong to the caller, so a training step allocates
//!   nothing after the first.
//! - Slices of wrong lengths panic with the layer, the slice, its length and the expected one;
//!   constructors return a [`LayerError`] for layers that cannot be built.
//! - [`ParallelChunks`] runs a minibatch in fixed chunks of samples on all threads of the current
//!   rayon pool, with the same bits for any number of threads. Large convolutions of a single image
//!   use two threads of the pool that they run in.
//!
#![doc = include_str!("../README.md")]

mod chunks;
mod error;
#[cfg(feature = "wgpu")]
pub mod gpu;
mod layers;
mod matrix;
mod real;
mod scratch;
mod shape;
mod window;

/// Mathematics of steerable kernels on the pixel grid, written for clarity rather than speed.
mod steerable {
    pub(crate) mod dense;
    pub(crate) mod hadamard;
    pub(crate) mod irrep_weights;
    pub(crate) mod taps;
    pub(crate) mod windows;
}

/// Inner loops of the convolutions on the CPU, written once for all instruction sets, and the
/// memory layout of their operands.
mod simd {
    pub(crate) mod gather;
    pub(crate) mod interleave;
    pub(crate) mod lanes;
    pub(crate) mod lines;
    pub(crate) mod patches;
    pub(crate) mod tiles;
}

/// Convolutions and fused poolings built from the kernels of [`simd`].
mod conv {
    pub(crate) mod backward;
    pub(crate) mod dispatch;
    pub(crate) mod epilogue;
    pub(crate) mod first_layer;
    pub(crate) mod forward;
    pub(crate) mod gradient_loader;
    pub(crate) mod line;
    pub(crate) mod maps;
    pub(crate) mod operands;
    pub(crate) mod pool;
    pub(crate) mod r2_conv;
    pub(crate) mod weights;
}

pub use chunks::ParallelChunks;
pub use error::LayerError;
pub use layers::*;
pub use real::Real;
pub use scratch::{BackwardArgs, Scratch};
pub use shape::Shape;
pub use simd::lanes::InstructionSet;
pub use simd::lines::pixel_byte_to_float;
pub use steerable::dense::{ClosestSteerableKernel, OrdinaryConv};
pub use steerable::hadamard::hadamard_transform;
pub use symmetry::{FieldType, Group};
pub use window::SlidingWindow;

//! Layers that are equivariant under D2 or a subgroup, with explicit forward and backward passes.
//!
//! A layer maps a feature map of one [`FieldType`] to another of the same [`Group`] and commutes with it:
//! f(g x) = g f(x) for every element g. The group is a value: C1 gives ordinary layers. Features live in the irrep
//! basis, where an equivariant linear map is block-diagonal (Schur's lemma), so
//! the entries of the blocks are the parameters and nothing is expanded.
//!
//! - Layers own no weights. The parameters of a network are one flat slice, in the order of its
//!   layers; gradients have the same layout.
//! - Feature maps are `[N, H, W, C]`, channels last, channels irrep-major ([`FieldType::range`]);
//!   vectors are maps of height and width 1.
//! - There is no tape: [`Layer::backward`] is called with what [`Layer::forward`] saw, and all
//!   buffers belong to the caller, so a training step allocates nothing after the first.
//! - [`Chunks`] runs a minibatch in fixed chunks of samples on all threads of the current
//!   rayon pool, with the same bits for any number of threads. Large convolutions of a single image use two
//!   threads of the pool that they run in.
//!
//! ```
//! use equivariant::{Group, Kernel, Layer, LayerError, R2Conv, Relu, Sequential, equivariance_error};
//! use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
//!
//! let kernel = Kernel { size: 4, stride: 2, padding: 1 };
//! let conv = R2Conv::new(Group::D2.trivial(3), Group::D2.regular(4), kernel, [8, 8])?;
//! let relu = Relu::new(Layer::<f32>::out_shape(&conv))?;
//! let net: Sequential<f32> = Sequential::new(vec![Box::new(conv), Box::new(relu)])?;
//!
//! let mut rng = ChaCha8Rng::seed_from_u64(1);
//! let mut params = vec![0.0; net.num_params()];
//! net.init(&mut rng, &mut params);
//! assert!(equivariance_error(&net, &params, 4, &mut rng) < 1e-5);
//! # Ok::<(), LayerError>(())
//! ```

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod average_pool;
mod blocks;
mod chain;
mod check;
mod chunks;
mod columns;
mod concat;
mod conv;
mod conv_backward;
mod conv_forward;
mod conv_lines;
mod conv_weights;
mod dense;
mod error;
mod gather;
mod group_mean;
mod hadamard;
mod init;
#[cfg(test)]
mod instruction_sets;
mod interchange;
mod join;
mod kernel;
mod lanes;
mod layer;
mod linear;
mod lines;
mod maps;
mod max_pool;
mod norm;
mod patches;
mod pool;
mod relu;
mod scalar;
mod sequential;
mod shape;
mod soft_argmax;
mod taps;
mod tiles;
mod window;

pub use average_pool::AveragePool;
pub use check::{equivariance_error, equivariance_error_of};
pub use chunks::Chunks;
pub use concat::Concat;
pub use conv::R2Conv;
pub use dense::{Dense, Projection};
pub use error::LayerError;
pub use group_mean::GroupMeanPool;
pub use hadamard::hadamard;
pub use interchange::{InterchangeError, load, save};
pub use kernel::Kernel;
pub use layer::Layer;
pub use linear::Linear;
pub use max_pool::MaxPool;
pub use norm::{FieldNorm, Statistics};
pub use pool::GroupMaxPool;
pub use relu::Relu;
pub use scalar::Scalar;
pub use sequential::Sequential;
pub use shape::Shape;
pub use soft_argmax::SpatialSoftArgmax;
pub use symmetry::{FieldType, Group};

//! Layers that are equivariant under D2 or a subgroup, with explicit forward and backward passes.
//!
//! A layer maps a feature map of one [`FieldType`] to another of the same [`Group`] and commutes
//! with it: f(g x) = g f(x) for every element g. The group is a value: C1 gives ordinary layers.
//! Features live in the irrep basis, where an equivariant linear map is block-diagonal (Schur's
//! lemma), so the entries of the blocks are the parameters and nothing is expanded.
//!
//! - Layers own no weights. The parameters of a network are one flat slice, in the order of its
//!   layers; gradients have the same layout.
//! - Feature maps are `[N, H, W, C]`, channels last, channels irrep-major ([`FieldType::range`]);
//!   vectors are maps of height and width 1.
//! - There is no tape: [`Layer::backward`] is called with what [`Layer::forward`] saw and with the
//!   [`Scratch`] that it left. All buffers belong to the caller, so a training step allocates
//!   nothing after the first.
//! - Slices of wrong lengths are a panic that names the layer, the slice, its length and the
//!   expected one; what cannot be built is a [`LayerError`].
//! - [`Chunks`] runs a minibatch in fixed chunks of samples on all threads of the current rayon
//!   pool, with the same bits for any number of threads. Large convolutions of a single image use
//!   two threads of the pool that they run in.
//!
//! ```
//! use equivariant::{
//!     Group, Kernel, Layer, LayerError, R2Conv, Relu, Sequential, Signature, equivariance_error,
//! };
//! use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
//!
//! let kernel = Kernel { size: 4, stride: 2, padding: 1 };
//! let conv = R2Conv::new(Group::D2.trivial(3), Group::D2.regular(4), kernel, [8, 8])?;
//! let relu = Relu::new(conv.out_shape())?;
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

mod backward_pass;
mod chunks;
mod conv;
mod error;
#[cfg(feature = "wgpu")]
pub mod gpu;
mod init;
mod instruction_set;
mod layers;
mod matrix;
mod order;
mod real;
mod scratch;
mod shape;
mod simd;
mod steerable;
mod window;

pub use backward_pass::BackwardPass;
pub use chunks::Chunks;
pub use error::LayerError;
pub use instruction_set::InstructionSet;
pub use layers::average_pool::AveragePool;
pub use layers::check::{equivariance_error, equivariance_error_of};
pub use layers::concat::Concat;
pub use layers::field_norm::{FieldNorm, Statistics};
pub use layers::group_max_pool::GroupMaxPool;
pub use layers::group_mean_pool::GroupMeanPool;
pub use layers::gru::Gru;
pub use layers::gru_pass::GruPass;
pub use layers::interchange::{InterchangeError, load, save};
pub use layers::layer::{Layer, Signature};
pub use layers::linear::Linear;
pub use layers::max_pool::MaxPool;
pub use layers::r2_conv::R2Conv;
pub use layers::relu::Relu;
pub use layers::scalar::Scalar;
pub use layers::sequential::Sequential;
pub use layers::soft_argmax::SpatialSoftArgmax;
pub use layers::units::unit_sums;
pub use real::Real;
pub use scratch::Scratch;
pub use shape::Shape;
pub use simd::pixels::level;
pub use steerable::dense::{Dense, Projection};
pub use steerable::hadamard::hadamard;
pub use symmetry::{FieldType, Group};
pub use window::Kernel;

//! What a layer is.

use std::fmt;

use rand::Rng;

use crate::{Dense, R2Conv, Scalar, Shape};

/// The gain of weights that are followed by a ReLU: it halves the second moment.
const RELU_GAIN: f64 = std::f64::consts::SQRT_2;

/// An equivariant map of feature maps that owns no weights.
///
/// Slices hold N samples one after the other, `[N, H, W, C]`; N is the length of `x` over
/// `in_shape().len()`. Methods panic when the lengths of their slices do not agree. What the trait provides is right
/// for a layer without parameters or scratch.
pub trait Layer<T: Scalar>: fmt::Display + Send + Sync {
    /// The shape of one input sample.
    fn in_shape(&self) -> Shape;

    /// The shape of one output sample.
    fn out_shape(&self) -> Shape;

    /// The number of parameters.
    fn num_params(&self) -> usize {
        0
    }

    /// Draws the weights with variance gain^2 / fan-in and sets the biases to zero; equal generators give equal weights.
    ///
    /// The generalisation of He et al. (ICCV 2015, equation 7) to these bases: output irrep b is y = sum_j w_j phi_j over its
    /// F columns phi, the folded patch, and independent weights of variance gain^2 / F give
    /// E_w y^2 = gain^2 (1/F) sum_j phi_j^2, gain^2 times the mean square of its columns. The fold is orthonormal, so columns have unit second
    /// moment when the taps are uncorrelated and of unit second moment. Between regular fields more is true: every entry of
    /// the patch appears, rotated, in the columns of exactly one irrep and all irreps have equally many, hence the
    /// mean of E_w y^2 over a field is gain^2 times the mean square of the patch, whatever its correlations. The
    /// change to the regular basis is orthonormal, so the same holds for the values that a ReLU sees.
    ///
    /// In a sequence, `gain` is that of the last layer with parameters; the layers before it keep the gain of
    /// [`init`](Layer::init).
    fn init_scaled(&self, _rng: &mut dyn Rng, _gain: f64, _params: &mut [T]) {}

    /// Draws the weights for a layer followed by a ReLU, which halves the second moment: gain sqrt(2).
    ///
    /// He et al., "Delving deep into rectifiers", ICCV 2015, equation 10.
    fn init(&self, rng: &mut dyn Rng, params: &mut [T]) {
        self.init_scaled(rng, RELU_GAIN, params);
    }

    /// The layer as an ordinary convolution, if it is linear and has weights.
    fn as_dense(&self) -> Option<Dense<'_>> {
        None
    }

    /// The layers of a chain, in order; their parameters follow one another. Other layers have none.
    fn layers(&self) -> &[Box<dyn Layer<T>>] {
        &[]
    }

    /// What a chain may fuse this layer as.
    #[doc(hidden)]
    fn fusible(&self) -> Option<Fusible<'_>> {
        None
    }

    /// The length that `scratch` must at least have for this many samples.
    fn scratch_len(&self, _samples: usize) -> usize {
        0
    }

    /// Whether `backward` reads what `forward` left in `scratch`.
    fn keeps_scratch(&self) -> bool {
        false
    }

    /// Writes f(x) into `y`. The contents of `scratch` on entry do not matter.
    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]);

    /// Adds the gradient in the parameters to `dparams` and, where asked for, writes that in the
    /// input into `dx`.
    ///
    /// `x` and `y` are those of the forward pass and `dy` is the gradient in `y`. When the
    /// layer [keeps its scratch](Layer::keeps_scratch), `scratch` must be as `forward` of the same
    /// samples left it.
    #[expect(
        clippy::too_many_arguments,
        reason = "flat slices, each with one meaning, and no tape that would hide them"
    )]
    fn backward(
        &self,
        params: &[T],
        x: &[T],
        y: &[T],
        dy: &[T],
        dx: Option<&mut [T]>,
        dparams: &mut [T],
        scratch: &mut [T],
    );
}

/// A layer that a chain knows how to fuse with its neighbours.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub enum Fusible<'a> {
    /// A convolution.
    Conv(&'a R2Conv),
    /// A ReLU.
    Relu,
}

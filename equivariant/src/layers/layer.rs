//! Traits of layers, and the kinds of layers for code that transforms networks.

use std::any::type_name;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};

use rand::Rng;

use crate::conv::dispatch::ConvPasses;
use crate::conv::r2_conv::R2Conv;
use crate::scratch::{BackwardPass, Scratch, ScratchOrigin};
use crate::shape::{MAX_VALUES, Shape};
use crate::steerable::dense::OrdinaryConv;
use crate::window::SlidingWindow;

/// Gain of weights that are followed by a ReLU, which halves the second moment.
const RELU_GAIN: f64 = std::f64::consts::SQRT_2;

/// Precision of a layer: `f32` for training, `f64` for gradient checks. Arithmetic is in
/// [`Real`](crate::Real).
pub trait Scalar: ConvPasses {}

impl Scalar for f32 {}
impl Scalar for f64 {}

/// Shapes and sizes of a layer, independent of the precision.
///
/// The provided methods suit a layer without parameters or scratch that keeps the shape. `Display`
/// must print every setting of a layer, since files of networks are compared by it.
pub trait LayerSignature: fmt::Display + Send + Sync {
    /// Returns the shape of one input sample.
    fn in_shape(&self) -> Shape;

    /// Returns the shape of one output sample.
    fn out_shape(&self) -> Shape {
        self.in_shape()
    }

    /// Returns the number of parameters of the layer.
    fn num_params(&self) -> usize {
        0
    }

    /// Returns the number of values of scratch memory that the passes of this many samples need.
    fn scratch_len(&self, _samples: usize) -> usize {
        0
    }

    /// Returns `true` if `backward` reads values that `forward` saved in the scratch.
    fn keeps_scratch(&self) -> bool {
        false
    }

    /// Returns a key that identifies layers whose scratches are compatible: a hash of type, shapes
    /// and number of parameters.
    ///
    /// Override it if the saved values depend on more. Every pass calls it, so it must not
    /// allocate.
    fn scratch_key(&self) -> u64 {
        let shapes = (self.in_shape(), self.out_shape());
        hash_of((type_name::<Self>(), shapes, self.num_params()))
    }
}

/// Layer of an equivariant network: a map between feature maps. It stores no parameters; each call
/// gets them as a slice.
///
/// Slices hold N samples one after the other, `[N, H, W, C]`; N is the length of `x` over
/// `in_shape().len()`. Callers use [`forward`](Layer::forward), [`backward`](Layer::backward) and
/// [`init`](Layer::init), which panic with the name of a slice whose length does not match the
/// shapes. A new layer implements `run_forward`, `run_backward` and, if it has parameters,
/// `draw_params`, and relies on those lengths.
pub trait Layer<T: Scalar>: LayerSignature {
    /// Writes the output f(x) of the layer for N samples into `y`. The contents of `scratch` on
    /// entry do not matter.
    ///
    /// # Panics
    /// When a slice has a wrong length, or the scratch is for fewer samples.
    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut Scratch<T>) {
        let samples = count_samples(self, "x", x.len());
        check_forward(self, samples, [params.len(), y.len()]);
        // marked as filled afterwards only, so a scratch is never used after a pass that panicked
        self.run_forward(params, x, y, take_unfilled_scratch(self, samples, scratch));
        mark_scratch_filled(self, samples, scratch);
    }

    /// Adds the gradient with respect to the parameters to `dparams` and writes the gradient with
    /// respect to the input into `dx`, if given.
    ///
    /// `x` and `y` are those of the forward pass and `dy` is the gradient with respect to `y`. If
    /// the layer [keeps its scratch](LayerSignature::keeps_scratch), `scratch` must be unchanged
    /// since `forward` of the same samples, or a clone of it.
    ///
    /// # Panics
    /// When a slice has a wrong length, or the scratch is for fewer samples. If the layer keeps its
    /// scratch, also when it was last used for another number of samples or by another layer.
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
        scratch: &mut Scratch<T>,
    ) {
        let samples = count_samples(self, "x", x.len());
        let dx_len = dx.as_ref().map_or(x.len(), |dx| dx.len());
        let lens = [params.len(), y.len(), dy.len(), dparams.len()];
        check_backward(self, samples, lens);
        check(self, [("dx", dx_len, x.len())]);
        self.run_backward(BackwardPass {
            params,
            x,
            y,
            dy,
            dx,
            dparams,
            scratch: take_filled_scratch(self, samples, scratch),
        });
    }

    /// Draws the weights for a layer followed by a ReLU, which halves the second moment: gain
    /// sqrt(2) (He et al., "Delving deep into rectifiers", ICCV 2015, equation 10).
    ///
    /// # Panics
    /// As [`init_with_gain`](Layer::init_with_gain).
    fn init(&self, rng: &mut dyn Rng, params: &mut [T]) {
        self.init_with_gain(rng, RELU_GAIN, params);
    }

    /// Draws the weights with variance gain^2 / fan-in and sets the biases to zero; equal
    /// generators give equal weights.
    ///
    /// The generalisation of He et al. (ICCV 2015, equation 7) to these bases: output irrep b is y
    /// = sum_j w_j phi_j over its F columns phi, the folded patch, and independent weights of
    /// variance gain^2 / F give E_w y^2 = gain^2 (1/F) sum_j phi_j^2, gain^2 times the mean square
    /// of its columns. The fold is orthonormal, so columns have unit second moment when the taps
    /// are uncorrelated and of unit second moment. Between regular fields more is true: every entry
    /// of the patch appears, rotated, in the columns of exactly one irrep and all irreps have
    /// equally many, hence the mean of E_w y^2 over a field is gain^2 times the mean square of the
    /// patch, whatever its correlations. The change to the regular basis is orthonormal, so the
    /// same holds for the inputs of a ReLU.
    ///
    /// In a sequence, `gain` is that of the last layer with parameters; the layers before it keep
    /// the gain of [`init`](Layer::init).
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    fn init_with_gain(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        check(self, [("params", params.len(), self.num_params())]);
        self.draw_params(rng, gain, params);
    }

    /// Allocates scratch memory for the passes of up to this many samples.
    ///
    /// # Panics
    /// For more than 2^31 samples.
    fn allocate_scratch(&self, samples: usize) -> Scratch<T> {
        assert!(
            samples <= MAX_VALUES,
            "{self}: got {samples} samples, expected at most {MAX_VALUES}"
        );
        Scratch::filled_with(self.scratch_len(samples), T::ZERO)
    }

    /// Returns the kind of layer, for code that fuses, exports or runs layers elsewhere. Layers
    /// without special treatment are [`LayerKind::Other`].
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// Implements [`init_with_gain`](Layer::init_with_gain), with a slice of the right length.
    fn draw_params(&self, _rng: &mut dyn Rng, _gain: f64, _params: &mut [T]) {}

    /// Implements [`forward`](Layer::forward), with slices of the right lengths; `scratch` has
    /// [`scratch_len`](LayerSignature::scratch_len) values.
    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]);

    /// Implements [`backward`](Layer::backward), with slices of the right lengths.
    fn run_backward(&self, pass: BackwardPass<T>);
}

/// Kind of a layer, with the settings that its shapes do not show.
#[non_exhaustive]
pub enum LayerKind<'a, T: Scalar> {
    /// Convolution that commutes with the symmetry group.
    R2Conv(&'a R2Conv),
    /// Linear map of vectors.
    Linear(Box<OrdinaryConv<'a>>),
    /// ReLU in the basis that the group permutes.
    Relu,
    /// Maximum over a window, in the basis that the group permutes.
    MaxPool(SlidingWindow),
    /// Average over a window.
    AveragePool(SlidingWindow),
    /// Maximum over the group of every regular field.
    GroupMaxPool,
    /// Mean over the group of every regular field.
    GroupMeanPool,
    /// Normalisation of every field with these statistics, then a scale and a shift.
    FieldNorm(&'a NormStatistics),
    /// Expected positions of the maxima of fields.
    SpatialSoftArgmax {
        /// Divisor of the values before the softmax.
        temperature: f64,
    },
    /// Chain of layers, whose parameters are in the same order.
    Sequential(&'a [Box<dyn Layer<T>>]),
    /// Any other layer, which only runs by its own passes.
    Other,
}

impl<'a, T: Scalar> LayerKind<'a, T> {
    /// Returns the layer as an ordinary convolution, if it is linear and has weights.
    pub fn as_ordinary_conv(&self) -> Option<OrdinaryConv<'a>> {
        match self {
            LayerKind::R2Conv(conv) => Some(conv.as_ordinary_conv()),
            LayerKind::Linear(dense) => Some(OrdinaryConv::clone(dense)),
            _ => None,
        }
    }
}

/// Source of mean and variance of a [`FieldNorm`](crate::FieldNorm).
#[derive(Clone, Debug, PartialEq)]
pub enum NormStatistics {
    /// Statistics of each sample separately, in training and inference alike (Ulyanov et al.,
    /// "Instance normalization", 2016).
    PerSample,
    /// Statistics of all samples of one call of `forward` (Ioffe and Szegedy, "Batch
    /// normalization", ICML 2015). In a minibatch that runs in chunks these are the samples of a
    /// chunk: ghost batch normalisation (Hoffer et al., NeurIPS 2017, section 4). Chunks are fixed,
    /// so the result does not depend on threads.
    Batch,
    /// Fixed `[mean, variance]` per field, such as
    /// [`FieldNorm::means_and_variances`](crate::FieldNorm::means_and_variances) of training data,
    /// for inference after training with `Batch`.
    Fixed(Vec<[f64; 2]>),
}

/// Layer without parameters; implements [`Layer`] in both precisions.
pub(crate) trait Parameterless: LayerSignature {
    /// Returns the layer's [`kind`](Layer::kind).
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// Runs the forward pass.
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]);

    /// Runs the backward pass for the gradient with respect to the input.
    fn pull_back<T: Scalar>(&self, x: &[T], y: &[T], dy: &[T], dx: &mut [T], scratch: &mut [T]);
}

impl<T: Scalar, L: Parameterless> Layer<T> for L {
    fn kind(&self) -> LayerKind<'_, T> {
        Parameterless::kind(self)
    }

    fn run_forward(&self, _params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        self.apply(x, y, scratch);
    }

    fn run_backward(&self, pass: BackwardPass<T>) {
        if let Some(dx) = pass.dx {
            self.pull_back(pass.x, pass.y, pass.dy, dx, pass.scratch);
        }
    }
}

/// Returns the layers of a chain, including those of nested chains; for any other layer, the layer.
pub(crate) fn flatten_layers<T: Scalar>(layer: &dyn Layer<T>) -> Vec<&dyn Layer<T>> {
    match layer.kind() {
        LayerKind::Sequential(layers) => {
            layers.iter().flat_map(|child| flatten_layers(child.as_ref())).collect()
        }
        _ => vec![layer],
    }
}

/// Returns the number of samples in an input of this name and length.
pub(crate) fn count_samples(
    layer: &(impl LayerSignature + ?Sized),
    input: &str,
    len: usize,
) -> usize {
    let each = layer.in_shape().len();
    assert!(
        len.is_multiple_of(each),
        "{layer}: got {input} of {len} values, expected a multiple of {each}"
    );
    len / each
}

/// Panics if a slice `(name, length, expected length)` does not have its expected length.
fn check<const N: usize>(
    layer: &(impl LayerSignature + ?Sized),
    slices: [(&'static str, usize, usize); N],
) {
    for (slice, got, expected) in slices {
        assert!(
            got == expected,
            "{layer}: got {slice} of {got} values, expected {expected}, as its shapes and x require"
        );
    }
}

/// Panics if the parameters or the output have wrong lengths.
pub(crate) fn check_forward(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    [params, y]: [usize; 2],
) {
    let out_len = samples * layer.out_shape().len();
    let slices = [("params", params, layer.num_params()), ("y", y, out_len)];
    check(layer, slices);
}

/// Panics if the parameters, the output or their gradients have wrong lengths.
pub(crate) fn check_backward(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    [params, y, dy, dparams]: [usize; 4],
) {
    check_forward(layer, samples, [params, y]);
    let out_len = samples * layer.out_shape().len();
    let slices = [("dy", dy, out_len), ("dparams", dparams, layer.num_params())];
    check(layer, slices);
}

/// Returns the part of the scratch for a forward pass and marks the scratch as unfilled.
pub(crate) fn take_unfilled_scratch<'a, T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    scratch.origin = ScratchOrigin::default();
    front(layer, samples, scratch)
}

/// Records that a forward pass of this layer filled the scratch, if the layer keeps it.
pub(crate) fn mark_scratch_filled<T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &mut Scratch<T>,
) {
    if layer.keeps_scratch() {
        scratch.origin = ScratchOrigin { samples, layer_key: layer.scratch_key() };
    }
}

/// Returns the part of the scratch for a backward pass, after checking that a forward pass filled
/// it if the layer keeps it.
pub(crate) fn take_filled_scratch<'a, T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    if layer.keeps_scratch() {
        check_filled(layer, samples, scratch.origin);
    } else {
        // this pass may overwrite values that another layer saved here
        scratch.origin = ScratchOrigin::default();
    }
    front(layer, samples, scratch)
}

/// Panics unless `forward` of this layer filled the scratch for these samples.
fn check_filled(layer: &(impl LayerSignature + ?Sized), samples: usize, origin: ScratchOrigin) {
    assert!(
        origin.samples == samples,
        "{layer}: got a scratch that forward left for {} samples, expected one for the \
         {samples} of x",
        origin.samples
    );
    assert!(
        origin.layer_key == layer.scratch_key(),
        "{layer}: got a scratch that forward of another layer left, expected one of this layer"
    );
}

/// Returns a hash without allocating.
pub(crate) fn hash_of(layer: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    layer.hash(&mut hasher);
    hasher.finish()
}

/// Returns the part of a scratch that this many samples use.
fn front<'a, T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    let (got, expected) = (scratch.len(), layer.scratch_len(samples));
    assert!(
        got >= expected,
        "{layer}: got a scratch of {got} values, expected at least {expected} for {samples} samples"
    );
    scratch.first_values(expected)
}

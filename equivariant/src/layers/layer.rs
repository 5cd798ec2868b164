//! Traits of layers, and the kinds of layers for code that transforms networks.

use std::any::type_name;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};

use rand::Rng;

use crate::conv::dispatch::ConvScalar;
use crate::conv::r2_conv::R2Conv;
use crate::scratch::{BackwardArgs, Scratch, ScratchOrigin};
use crate::shape::{MAX_VALUES, Shape};
use crate::steerable::dense::OrdinaryConv;
use crate::window::SlidingWindow;

/// Factor sqrt(2) on the standard deviation of the initial weights before a ReLU, which halves the
/// second moment.
const RELU_GAIN: f64 = std::f64::consts::SQRT_2;

/// Floating-point type of a layer's values: `f32` for training, `f64` for gradient checks.
/// [`Real`](crate::Real) has the arithmetic.
pub trait Scalar: ConvScalar {}

impl Scalar for f32 {}
impl Scalar for f64 {}

/// Shapes and sizes of a layer, independent of the precision.
///
/// The provided methods suit a layer without parameters or scratch that keeps the shape. `Display`
/// names a layer in messages, with its shapes and settings.
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

    /// Returns the length, in values, of the scratch memory that the forward and the backward pass
    /// over this many samples need.
    fn scratch_len(&self, _samples: usize) -> usize {
        0
    }

    /// Returns `true` if the layer's `backward` reads values that its `forward` saved in the
    /// scratch memory.
    fn backward_reads_scratch(&self) -> bool {
        false
    }

    /// Returns a key that is equal for layers that can use each other's filled scratch memory: a
    /// hash of type, shapes and number of parameters.
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
/// `run_init`, and relies on those lengths.
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
    /// the layer [keeps its scratch](LayerSignature::backward_reads_scratch), `scratch` must be
    /// unchanged since `forward` of the same samples, or a clone of it.
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
        self.run_backward(BackwardArgs {
            params,
            x,
            y,
            dy,
            dx,
            dparams,
            scratch: take_filled_scratch(self, samples, scratch),
        });
    }

    /// Samples the initial weights with gain sqrt(2), for a layer followed by a ReLU, which halves
    /// the second moment (He et al., "Delving deep into rectifiers", ICCV 2015, equation 10).
    ///
    /// # Panics
    /// As [`init_with_gain`](Layer::init_with_gain).
    fn init(&self, rng: &mut dyn Rng, params: &mut [T]) {
        self.init_with_gain(rng, RELU_GAIN, params);
    }

    /// Samples the initial weights with variance gain^2 / fan-in and sets the biases to zero;
    /// random generators in equal states give equal weights.
    ///
    /// The generalisation of He et al. (ICCV 2015, equation 7) to these bases: output irrep b is y
    /// = sum_j w_j phi_j over its F columns phi, the folded patch (signed sums of the taps that the
    /// group maps to one another), and independent weights of variance gain^2 / F give E_w y^2 =
    /// gain^2 (1/F) sum_j phi_j^2, gain^2 times the mean square of its columns. The fold is
    /// orthonormal, so columns have unit second moment when the taps are uncorrelated and of unit
    /// second moment. Between regular fields more is true: every entry of the patch appears,
    /// rotated, in the columns of exactly one irrep and all irreps have equally many, hence the
    /// mean of E_w y^2 over a field is gain^2 times the mean square of the patch, whatever its
    /// correlations. The change to the regular basis is orthonormal, so the same holds for the
    /// inputs of a ReLU.
    ///
    /// In a sequence, `gain` is that of the last layer with parameters; the layers before it keep
    /// the gain of [`init`](Layer::init).
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    fn init_with_gain(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        check(self, [("params", params.len(), self.num_params())]);
        self.run_init(rng, gain, params);
    }

    /// Allocates scratch memory for forward and backward passes over up to `samples` samples.
    ///
    /// # Panics
    /// For more than 2^31 samples.
    fn allocate_scratch(&self, samples: usize) -> Scratch<T> {
        assert!(
            samples <= MAX_VALUES,
            "{self}: got {samples} samples, expected at most {MAX_VALUES}"
        );
        Scratch::new_filled(self.scratch_len(samples), T::ZERO)
    }

    /// Returns the kind of the layer, for code that fuses layers, exports them or runs them on a
    /// GPU. Layers without special treatment are [`LayerKind::Other`].
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// Implements [`init_with_gain`](Layer::init_with_gain), with a slice of the right length.
    fn run_init(&self, _rng: &mut dyn Rng, _gain: f64, _params: &mut [T]) {}

    /// Implements [`forward`](Layer::forward), with slices of the right lengths; `scratch` has
    /// [`scratch_len`](LayerSignature::scratch_len) values.
    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]);

    /// Implements [`backward`](Layer::backward), with slices of the right lengths.
    fn run_backward(&self, args: BackwardArgs<T>);
}

/// Kind of a layer, with the settings that its shapes do not show.
#[non_exhaustive]
pub enum LayerKind<'a, T: Scalar> {
    /// Convolution that commutes with the symmetry group.
    R2Conv(&'a R2Conv),
    /// Equivariant linear map of vectors, given as a convolution of one tap.
    Linear(Box<OrdinaryConv<'a>>),
    /// ReLU on the channels in the basis that the group permutes.
    Relu,
    /// Maximum of every channel over a sliding window of pixels, in the basis that the group
    /// permutes.
    MaxPool(SlidingWindow),
    /// Maximum of every regular field over the elements of the group.
    GroupMaxPool,
    /// Chain of layers, whose parameters lie one after another in the order of the layers.
    Sequential(&'a [Box<dyn Layer<T>>]),
    /// Any other layer, which runs only through its own `forward` and `backward`.
    Other,
}

impl<'a, T: Scalar> LayerKind<'a, T> {
    /// Returns a layer of kind `R2Conv` or `Linear` as an ordinary convolution; `None` for other
    /// kinds.
    pub fn as_ordinary_conv(&self) -> Option<OrdinaryConv<'a>> {
        match self {
            LayerKind::R2Conv(conv) => Some(conv.as_ordinary_conv()),
            LayerKind::Linear(dense) => Some(OrdinaryConv::clone(dense)),
            _ => None,
        }
    }
}

/// Layer without parameters; every type that implements it is a [`Layer`] in both precisions.
pub(crate) trait Parameterless: LayerSignature {
    /// Returns the kind of the layer, as [`Layer::kind`] does.
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// Writes the output of the layer for the samples `x` into `y`.
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]);

    /// Writes the gradient with respect to the input into `dx`, from the gradient `dy` with respect
    /// to the output `y`.
    fn backprop<T: Scalar>(&self, x: &[T], y: &[T], dy: &[T], dx: &mut [T], scratch: &mut [T]);
}

impl<T: Scalar, L: Parameterless> Layer<T> for L {
    fn kind(&self) -> LayerKind<'_, T> {
        Parameterless::kind(self)
    }

    fn run_forward(&self, _params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]) {
        self.apply(x, y, scratch);
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        if let Some(dx) = args.dx {
            self.backprop(args.x, args.y, args.dy, dx, args.scratch);
        }
    }
}

/// Returns the number of samples in an input slice of `len` values; panics with the slice's name
/// `input` if the samples are not whole.
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

/// Panics if one of the slices `(name, length, expected length)` does not have its expected length.
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

/// Panics if the parameters or the output of a forward pass have wrong lengths.
pub(crate) fn check_forward(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    [params, y]: [usize; 2],
) {
    let out_len = samples * layer.out_shape().len();
    let slices = [("params", params, layer.num_params()), ("y", y, out_len)];
    check(layer, slices);
}

/// Panics if the parameters, the output or their gradients in a backward pass have wrong lengths.
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

/// Returns the part of the scratch memory for a forward pass and marks the memory as not filled.
pub(crate) fn take_unfilled_scratch<'a, T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    scratch.origin = ScratchOrigin::default();
    used_scratch(layer, samples, scratch)
}

/// Records that a forward pass of this layer filled the scratch memory, if the backward pass reads
/// the values there.
pub(crate) fn mark_scratch_filled<T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &mut Scratch<T>,
) {
    if layer.backward_reads_scratch() {
        scratch.origin = ScratchOrigin { samples, layer_key: layer.scratch_key() };
    }
}

/// Returns the part of the scratch memory for a backward pass, after checking that a forward pass
/// filled it if the layer reads saved values.
pub(crate) fn take_filled_scratch<'a, T: Scalar>(
    layer: &(impl LayerSignature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    if layer.backward_reads_scratch() {
        check_filled(layer, samples, scratch.origin);
    } else {
        // this pass may overwrite values that another layer saved here
        scratch.origin = ScratchOrigin::default();
    }
    used_scratch(layer, samples, scratch)
}

/// Panics unless `forward` of this layer filled the scratch memory for this number of samples.
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

/// Returns the hash of a value without allocating memory.
pub(crate) fn hash_of(layer: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    layer.hash(&mut hasher);
    hasher.finish()
}

/// Returns the part of a layer's scratch memory that `samples` samples use.
fn used_scratch<'a, T: Scalar>(
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

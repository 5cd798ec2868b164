//! Layers, and what planners see of them.

use std::any::type_name;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};

use rand::Rng;

use crate::conv::dispatch::Passes;
use crate::conv::r2_conv::R2Conv;
use crate::scratch::{BackwardPass, Scratch};
use crate::shape::{LARGEST, Shape};
use crate::steerable::dense::Dense;
use crate::window::Kernel;

/// The gain of weights that are followed by a ReLU: it halves the second moment.
const RELU_GAIN: f64 = std::f64::consts::SQRT_2;

/// `f32` for training and `f64` for gradient checks. What they can do is in [`Real`](crate::Real).
pub trait Scalar: Passes {}

impl Scalar for f32 {}
impl Scalar for f64 {}

/// Shapes and sizes of a layer, whatever the precision.
///
/// The provided methods are right for a layer without parameters or scratch. A layer prints
/// everything that it was built with, since files of networks are compared by it.
pub trait Signature: fmt::Display + Send + Sync {
    /// The shape of one input sample.
    fn in_shape(&self) -> Shape;

    /// The shape of one output sample.
    fn out_shape(&self) -> Shape;

    /// The number of parameters.
    fn num_params(&self) -> usize {
        0
    }

    /// The number of values that the passes of this many samples need for themselves.
    fn scratch_len(&self, _samples: usize) -> usize {
        0
    }

    /// `true` where `backward` reads what `forward` left in the scratch.
    fn keeps_scratch(&self) -> bool {
        false
    }

    /// Number that tells layers apart whose scratches are kept: a hash of their type, shapes and
    /// number of parameters. A layer whose kept scratch depends on more overrides it. Every pass
    /// asks for it, so it must not allocate.
    fn scratch_key(&self) -> u64 {
        let shapes = (self.in_shape(), self.out_shape());
        hash_of((type_name::<Self>(), shapes, self.num_params()))
    }
}

/// An equivariant map of feature maps that owns no weights.
///
/// Slices hold N samples one after the other, `[N, H, W, C]`; N is the length of `x` over
/// `in_shape().len()`. [`forward`](Layer::forward), [`backward`](Layer::backward) and
/// [`init`](Layer::init) are what callers use: they panic when a slice has another length than the
/// shapes say, and name it. A new layer implements `run_forward`, `run_backward` and, if it has
/// parameters, `draw`, and relies on those lengths.
pub trait Layer<T: Scalar>: Signature {
    /// Writes f(x) into `y`. The contents of `scratch` on entry do not matter.
    ///
    /// # Panics
    /// When a slice has a wrong length, or the scratch is for fewer samples.
    fn forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut Scratch<T>) {
        let samples = samples(self, ("x", x.len()));
        check_forward(self, samples, [params.len(), y.len()]);
        self.run_forward(params, x, y, empty(self, samples, scratch));
        fill(self, samples, scratch);
    }

    /// Adds the gradient in the parameters to `dparams` and, where asked for, writes that in the
    /// input into `dx`.
    ///
    /// `x` and `y` are those of the forward pass and `dy` is the gradient in `y`. When the layer
    /// [keeps its scratch](Signature::keeps_scratch), `scratch` must be as `forward` of the same
    /// samples left it, or a clone of that.
    ///
    /// # Panics
    /// When a slice has a wrong length, or the scratch is for fewer samples. Where the scratch is
    /// kept, also when it was last used for another number of samples or by another layer.
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
        let samples = samples(self, ("x", x.len()));
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
            scratch: filled(self, samples, scratch),
        });
    }

    /// Draws the weights for a layer followed by a ReLU, which halves the second moment: gain
    /// sqrt(2).
    ///
    /// He et al., "Delving deep into rectifiers", ICCV 2015, equation 10.
    ///
    /// # Panics
    /// As [`init_scaled`](Layer::init_scaled).
    fn init(&self, rng: &mut dyn Rng, params: &mut [T]) {
        self.init_scaled(rng, RELU_GAIN, params);
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
    /// same holds for the values that a ReLU sees.
    ///
    /// In a sequence, `gain` is that of the last layer with parameters; the layers before it keep
    /// the gain of [`init`](Layer::init).
    ///
    /// # Panics
    /// When `params` does not hold the layer's parameters.
    fn init_scaled(&self, rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        check(self, [("params", params.len(), self.num_params())]);
        self.draw(rng, gain, params);
    }

    /// Memory for the passes of up to this many samples.
    ///
    /// # Panics
    /// For more than 2^31 samples.
    fn scratch(&self, samples: usize) -> Scratch<T> {
        assert!(samples <= LARGEST, "{self}: got {samples} samples, expected at most {LARGEST}");
        Scratch::filled(self.scratch_len(samples), T::ZERO)
    }

    /// The kind of layer, for planners: who fuses, exports or runs layers elsewhere looks at it.
    /// Layers that nobody treats in a way of its own are [`LayerKind::Other`].
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// The work of [`init_scaled`](Layer::init_scaled), with a slice of the right length.
    fn draw(&self, _rng: &mut dyn Rng, _gain: f64, _params: &mut [T]) {}

    /// The work of [`forward`](Layer::forward), with slices of the right lengths; `scratch` has
    /// those that [`scratch_len`](Signature::scratch_len) asks for.
    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], scratch: &mut [T]);

    /// The work of [`backward`](Layer::backward), with slices of the right lengths.
    fn run_backward(&self, pass: BackwardPass<T>);
}

/// Kinds of layers, with what planners need besides the shapes.
#[non_exhaustive]
pub enum LayerKind<'a, T: Scalar> {
    /// A convolution.
    R2Conv(&'a R2Conv),
    /// A linear map of vectors.
    Linear(Box<Dense<'a>>),
    /// The ReLU in the basis that the group permutes.
    Relu,
    /// The largest value of a window, in the basis that the group permutes.
    MaxPool(Kernel),
    /// The average of a window.
    AveragePool(Kernel),
    /// The largest value of a regular field.
    GroupMaxPool,
    /// The mean of a regular field.
    GroupMeanPool,
    /// Normalised fields.
    FieldNorm(&'a Statistics),
    /// The expected positions of the maxima of fields.
    SpatialSoftArgmax {
        /// Divisor of the values.
        temperature: f64,
    },
    /// Layers one after the other; so are their parameters.
    Sequential(&'a [Box<dyn Layer<T>>]),
    /// Any other layer: it runs by its own passes only.
    Other,
}

impl<'a, T: Scalar> LayerKind<'a, T> {
    /// The layer as an ordinary convolution, if it is linear and has weights.
    pub fn dense(&self) -> Option<Dense<'a>> {
        match self {
            LayerKind::R2Conv(conv) => Some(conv.dense()),
            LayerKind::Linear(dense) => Some(Dense::clone(dense)),
            _ => None,
        }
    }
}

/// Source of the mean and the variance of a [`FieldNorm`](crate::FieldNorm).
#[derive(Clone, Debug, PartialEq)]
pub enum Statistics {
    /// Statistics of each sample alone (Ulyanov et al., "Instance normalization", 2016): the same
    /// at training and inference.
    Sample,
    /// Statistics of all samples of one call of `forward` (Ioffe and Szegedy, "Batch
    /// normalization", ICML 2015). In a minibatch that runs in chunks that is the chunk: ghost
    /// batch normalisation (Hoffer et al., NeurIPS 2017, section 4). Chunks are fixed, so the
    /// result does not depend on threads.
    Batch,
    /// Fixed ones, `[mean, variance]` per field, such as
    /// [`FieldNorm::moments`](crate::FieldNorm::moments) of training data: for inference after
    /// training with `Batch`.
    Fixed(Vec<[f64; 2]>),
}

/// A map without parameters, which is a [`Layer`] in either precision.
pub(crate) trait Parameterless: Signature {
    /// The layer's [`kind`](Layer::kind).
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::Other
    }

    /// The forward pass.
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]);

    /// The backward pass where the gradient in the input is asked for.
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

/// The layers of a chain, those of chains inside it included; any other layer is its only one.
pub(crate) fn leaves<T: Scalar>(layer: &dyn Layer<T>) -> Vec<&dyn Layer<T>> {
    match layer.kind() {
        LayerKind::Sequential(layers) => {
            let layers = layers.iter();
            layers.flat_map(|layer| leaves(layer.as_ref())).collect()
        }
        _ => vec![layer],
    }
}

/// The number of samples in an input of this name and length.
pub(crate) fn samples(layer: &(impl Signature + ?Sized), (input, len): (&str, usize)) -> usize {
    let each = layer.in_shape().len();
    assert!(
        len.is_multiple_of(each),
        "{layer}: got {input} of {len} values, expected a multiple of {each}"
    );
    len / each
}

/// Refuses slices that do not have the length that the shapes and the samples in `x` ask for.
fn check<const N: usize>(
    layer: &(impl Signature + ?Sized),
    slices: [(&'static str, usize, usize); N],
) {
    for (slice, got, expected) in slices {
        assert!(
            got == expected,
            "{layer}: got {slice} of {got} values, expected {expected}, as its shapes and x say"
        );
    }
}

/// Refuses parameters and an output of wrong lengths.
pub(crate) fn check_forward(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    [params, y]: [usize; 2],
) {
    let out_len = samples * layer.out_shape().len();
    let slices = [("params", params, layer.num_params()), ("y", y, out_len)];
    check(layer, slices);
}

/// Refuses parameters, an output and their gradients of wrong lengths.
pub(crate) fn check_backward(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    [params, y, dy, dparams]: [usize; 4],
) {
    check_forward(layer, samples, [params, y]);
    let out_len = samples * layer.out_shape().len();
    let slices = [("dy", dy, out_len), ("dparams", dparams, layer.num_params())];
    check(layer, slices);
}

/// The scratch that a forward pass of so many samples writes.
pub(crate) fn empty<'a, T: Scalar>(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    scratch.set_filled(0, 0);
    front(layer, samples, scratch)
}

/// Notes what a forward pass has left in the scratch.
pub(crate) fn fill<T: Scalar>(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    scratch: &mut Scratch<T>,
) {
    if layer.keeps_scratch() {
        scratch.set_filled(samples, layer.scratch_key());
    }
}

/// The scratch that a backward pass of so many samples uses: as the forward pass left it, where the
/// layer keeps it.
pub(crate) fn filled<'a, T: Scalar>(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    if layer.keeps_scratch() {
        check_filled(layer, samples, scratch.filled_by());
    } else {
        // another layer may have left something here, which this pass writes over
        scratch.set_filled(0, 0);
    }
    front(layer, samples, scratch)
}

/// Refuses a scratch that `forward` of this layer did not leave for these samples.
fn check_filled(layer: &(impl Signature + ?Sized), samples: usize, (filled, key): (usize, u64)) {
    assert!(
        filled == samples,
        "{layer}: got a scratch that forward left for {filled} samples, expected one for the \
         {samples} of x"
    );
    assert!(
        key == layer.scratch_key(),
        "{layer}: got a scratch that forward of another layer left, expected one of this layer"
    );
}

/// A hash, made without allocations.
pub(crate) fn hash_of(layer: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    layer.hash(&mut hasher);
    hasher.finish()
}

/// The part of a scratch that this many samples use.
fn front<'a, T: Scalar>(
    layer: &(impl Signature + ?Sized),
    samples: usize,
    scratch: &'a mut Scratch<T>,
) -> &'a mut [T] {
    let (got, expected) = (scratch.len(), layer.scratch_len(samples));
    assert!(
        got >= expected,
        "{layer}: got a scratch of {got} values, expected at least {expected} for {samples} samples"
    );
    scratch.front(expected)
}

//! Normalisation of fields.

use std::array::from_fn;
use std::fmt;
use std::ops::Range;
use std::slice::ChunksExact;

use rand::Rng;
use symmetry::{FieldType, Group, Irrep};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{Layer, LayerKind, LayerSignature, NormStatistics, Scalar};
use crate::scratch::BackwardArgs;
use crate::shape::Shape;

/// Constant added to every variance against division by zero, the default of PyTorch's
/// normalisations.
pub(crate) const VARIANCE_EPSILON: f64 = 1e-5;
/// Number of fields that are normalised together, few enough that their sums live on the stack.
const FIELDS_AT_ONCE: usize = 8;

/// Layer that normalises every field to mean 0 and variance 1, then scales and shifts it.
///
/// Statistics are over the group, space and samples. For regular fields, mean and variance are
/// those of the values in the regular basis. In the irrep basis the mean is the trivial
/// coefficient's and the transform is orthonormal, so no change of basis is needed: with G
/// coefficients c_a a field, mu = E c_0 and var = (sum_a E c_a^2 - mu^2) / G, and y_a = gain (c_a -
/// mu \[a = 0\]) / sqrt(var + 1e-5) + bias \[a = 0\].
///
/// In other types every channel is a field of its own. Channels of odd irreps have mean 0 over the
/// group and are only scaled. The parameters are one gain per field, then one bias per trivial
/// channel, in units of its coefficient.
#[derive(Clone, Debug)]
pub struct FieldNorm {
    shape: Shape,
    /// Number of channels of a field; the channels of field f are f, f + fields, f + 2 fields ...
    order: usize,
    fields: usize,
    statistics: NormStatistics,
}

/// Shift and scale that normalise a field's coefficients.
#[derive(Clone, Copy)]
struct Normaliser<T> {
    /// Mean of the field's first coefficient; the others have mean 0.
    mean: T,
    /// Reciprocal of the standard deviation of the field's values.
    inverse: T,
}

/// Inputs that share mean and variance, with the gradients with respect to their outputs.
#[derive(Clone, Copy)]
struct InputsAndGradients<'a, T> {
    x: &'a [T],
    dy: &'a [T],
}

impl<T: Scalar> Normaliser<T> {
    #[inline(always)]
    fn apply(self, coefficient: usize, x: T) -> T {
        match coefficient {
            0 => (x - self.mean) * self.inverse,
            _ => x * self.inverse,
        }
    }
}

/// Returns the reciprocal of the standard deviation for a variance, to which [`VARIANCE_EPSILON`]
/// is added.
fn inverse(variance: f64) -> f64 {
    (variance + VARIANCE_EPSILON).sqrt().recip()
}

impl FieldNorm {
    /// Creates the normalisation of the fields of maps of this shape.
    ///
    /// # Errors
    /// When the map is empty, or fixed statistics are not one mean and one variance of at least 0
    /// per field. The mean and the reciprocal of the standard deviation must be usable in single
    /// precision. A field of an odd irrep must have mean 0: another would not be equivariant.
    pub fn new(shape: Shape, statistics: NormStatistics) -> Result<FieldNorm, LayerError> {
        LayerError::check_map("FieldNorm", shape, 0)?;
        let (order, fields) = match shape.fields.num_regular_fields() {
            Some(fields) => (shape.fields.group().order(), fields),
            None => (1, shape.fields.dim()),
        };
        let norm = FieldNorm { shape, order, fields, statistics };
        norm.check_statistics()?;
        Ok(norm)
    }

    fn check_statistics(&self) -> Result<(), LayerError> {
        let NormStatistics::Fixed(moments) = &self.statistics else {
            return Ok(());
        };
        let mut of_fields = moments.iter().enumerate();
        let usable = of_fields.all(|(f, &[mean, variance])| {
            // passes in single precision use exactly these two numbers
            let finite = (mean as f32).is_finite() && (inverse(variance) as f32).is_normal();
            finite && variance >= 0.0 && (mean == 0.0 || self.centred(f))
        });
        if moments.len() == self.fields && usable {
            return Ok(());
        }
        Err(LayerError::InvalidSetting {
            layer: "FieldNorm",
            setting: "fixed statistics",
            got: format!("{moments:?}"),
            expected: "a mean and a variance of at least 0 for each field, finite in single \
                       precision, as is one over the deviation, and a mean of 0 in odd irreps",
        })
    }

    /// Returns `[mean, variance]` of every field over all samples of `x`, in the units of
    /// [`NormStatistics::Fixed`].
    ///
    /// # Panics
    /// When `x` is empty or is not whole samples.
    pub fn means_and_variances<T: Scalar>(&self, x: &[T]) -> Vec<[f64; 2]> {
        let (got, each) = (x.len(), self.shape.len());
        assert!(
            got > 0 && got.is_multiple_of(each),
            "{self}: got x of {got} values, expected a multiple of {each} above 0"
        );
        let firsts = (0..self.fields).step_by(FIELDS_AT_ONCE);
        let moments = firsts.flat_map(|first| self.field_moments(x, first));
        moments.take(self.fields).collect()
    }

    /// Returns `true` if a field has a trivial channel, which is the one with a mean and a bias.
    fn centred(&self, field: usize) -> bool {
        field < self.shape.fields.multiplicity(Irrep::Trivial)
    }

    /// Iterates over the coefficients of the [`FIELDS_AT_ONCE`] fields from `first` on, with the
    /// range of their channels; only channels of the first coefficient can be trivial.
    fn channels(&self, first: usize) -> impl Iterator<Item = (usize, Range<usize>)> + use<> {
        let (fields, end) = (self.fields, self.fields.min(first + FIELDS_AT_ONCE));
        (0..self.order).map(move |a| (a, a * fields + first..a * fields + end))
    }

    /// Iterates over the pixels of feature maps, each a slice of all channels.
    fn pixels<'a, T>(&self, x: &'a [T]) -> ChunksExact<'a, T> {
        x.chunks_exact(self.shape.fields.dim())
    }

    /// Returns `[mean, variance]` of the [`FIELDS_AT_ONCE`] fields from `first` on, summed in
    /// double precision.
    fn field_moments<T: Scalar>(&self, x: &[T], first: usize) -> [[f64; 2]; FIELDS_AT_ONCE] {
        let pixels = self.pixels(x).len().max(1) as f64;
        let mut means = [0.0; FIELDS_AT_ONCE];
        for pixel in self.pixels(x) {
            for (sum, v) in means.iter_mut().zip(&pixel[first..]) {
                *sum += v.to_f64();
            }
        }
        let means: [f64; FIELDS_AT_ONCE] =
            from_fn(|j| if self.centred(first + j) { means[j] / pixels } else { 0.0 });
        // a second pass over centred values: E x^2 - mu^2 would cancel for large means
        let mut squares = [0.0; FIELDS_AT_ONCE];
        for pixel in self.pixels(x) {
            for (a, channels) in self.channels(first) {
                for (j, v) in pixel[channels].iter().enumerate() {
                    let centre = if a == 0 { means[j] } else { 0.0 };
                    squares[j] += (v.to_f64() - centre).powi(2);
                }
            }
        }
        from_fn(|j| [means[j], squares[j] / (pixels * self.order as f64)])
    }

    /// Returns the shift and scale that normalise the [`FIELDS_AT_ONCE`] fields from `first` on.
    fn normalisers<T: Scalar>(&self, x: &[T], first: usize) -> [Normaliser<T>; FIELDS_AT_ONCE] {
        let moments = match &self.statistics {
            NormStatistics::Fixed(moments) => {
                from_fn(|j| moments.get(first + j).copied().unwrap_or_default())
            }
            _ => self.field_moments(x, first),
        };
        moments.map(|[mean, variance]| Normaliser {
            mean: T::from_f64(mean),
            inverse: T::from_f64(inverse(variance)),
        })
    }

    /// Returns the number of consecutive values that share mean and variance.
    fn statistics_len(&self, len: usize) -> usize {
        match self.statistics {
            NormStatistics::PerSample => self.shape.len(),
            _ => len.max(1),
        }
    }

    /// Writes the outputs of the [`FIELDS_AT_ONCE`] fields from `first` on: normalised, then scaled
    /// and shifted.
    fn forward_fields<T: Scalar>(&self, params: &[T], first: usize, x: &[T], y: &mut [T]) {
        let (gains, biases) = params.split_at(self.fields);
        let normalisers = self.normalisers(x, first);
        let dim = self.shape.fields.dim();
        for (pixel, out) in self.pixels(x).zip(y.chunks_exact_mut(dim)) {
            for (a, channels) in self.channels(first) {
                let values = pixel[channels.clone()].iter().zip(&mut out[channels]);
                for (j, (&value, normalised)) in values.enumerate() {
                    *normalised = gains[first + j] * normalisers[j].apply(a, value);
                    if a == 0 && self.centred(first + j) {
                        *normalised += biases[first + j];
                    }
                }
            }
        }
    }

    /// Returns, for each of the [`FIELDS_AT_ONCE`] fields from `first` on, the sum of dy times the
    /// normalised input and the sum of dy in the first coefficient.
    fn gradient_sums<T: Scalar>(
        &self,
        normalisers: &[Normaliser<T>; FIELDS_AT_ONCE],
        first: usize,
        values: InputsAndGradients<T>,
    ) -> [[f64; 2]; FIELDS_AT_ONCE] {
        let mut sums = [[0.0; 2]; FIELDS_AT_ONCE];
        for (x, dy) in self.pixels(values.x).zip(self.pixels(values.dy)) {
            for (a, channels) in self.channels(first) {
                let pairs = x[channels.clone()].iter().zip(&dy[channels]);
                for (j, (&value, &gradient)) in pairs.enumerate() {
                    sums[j][0] += (normalisers[j].apply(a, value) * gradient).to_f64();
                    sums[j][1] += if a == 0 { gradient.to_f64() } else { 0.0 };
                }
            }
        }
        sums
    }

    /// Adds the parameter gradients of the [`FIELDS_AT_ONCE`] fields from `first` on, and writes
    /// the gradient with respect to their input.
    fn backward_fields<T: Scalar>(
        &self,
        params: &[T],
        first: usize,
        values: InputsAndGradients<T>,
        dx: Option<&mut [T]>,
        dparams: &mut [T],
    ) {
        let normalisers = self.normalisers(values.x, first);
        let sums = self.gradient_sums(&normalisers, first, values);
        for (f, [scaled, shifted]) in (first..self.fields).zip(sums) {
            dparams[f] += T::from_f64(scaled);
            if self.centred(f) {
                dparams[self.fields + f] += T::from_f64(shifted);
            }
        }
        if let Some(dx) = dx {
            let means = self.gradient_means(first, values.x, sums);
            self.input_gradient(params, first, &normalisers, means, values, dx);
        }
    }

    /// Returns the means of dy times the normalised input, and of dy, for the [`FIELDS_AT_ONCE`]
    /// fields from `first` on: the gradient through mean and variance subtracts them.
    fn gradient_means<T: Scalar>(
        &self,
        first: usize,
        x: &[T],
        sums: [[f64; 2]; FIELDS_AT_ONCE],
    ) -> [[T; 2]; FIELDS_AT_ONCE] {
        if matches!(self.statistics, NormStatistics::Fixed(_)) {
            return [[T::ZERO; 2]; FIELDS_AT_ONCE];
        }
        let pixels = self.pixels(x).len() as f64;
        from_fn(|j| {
            let [scaled, shifted] = sums[j];
            let shifted = if self.centred(first + j) { shifted } else { 0.0 };
            [scaled / (pixels * self.order as f64), shifted / pixels].map(T::from_f64)
        })
    }

    /// Writes the gradient with respect to the input of the [`FIELDS_AT_ONCE`] fields from `first`
    /// on.
    fn input_gradient<T: Scalar>(
        &self,
        params: &[T],
        first: usize,
        normalisers: &[Normaliser<T>; FIELDS_AT_ONCE],
        means: [[T; 2]; FIELDS_AT_ONCE],
        values: InputsAndGradients<T>,
        dx: &mut [T],
    ) {
        let dim = self.shape.fields.dim();
        let inputs = self.pixels(values.x).zip(self.pixels(values.dy));
        for ((x, dy), gradient) in inputs.zip(dx.chunks_exact_mut(dim)) {
            for (a, channels) in self.channels(first) {
                let pairs = x[channels.clone()].iter().zip(&dy[channels.clone()]);
                for (j, ((&value, &upstream), entry)) in
                    pairs.zip(&mut gradient[channels]).enumerate()
                {
                    let [scaled, shifted] = means[j];
                    let rest = upstream - normalisers[j].apply(a, value) * scaled;
                    let rest = if a == 0 { rest - shifted } else { rest };
                    *entry = params[first + j] * normalisers[j].inverse * rest;
                }
            }
        }
    }
}

impl LayerSignature for FieldNorm {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn num_params(&self) -> usize {
        self.fields + self.shape.fields.multiplicity(Irrep::Trivial)
    }
}

impl<T: Scalar> Layer<T> for FieldNorm {
    fn kind(&self) -> LayerKind<'_, T> {
        LayerKind::FieldNorm(&self.statistics)
    }

    /// Sets the gains to `gain` and the biases to zero, without random numbers.
    fn run_init(&self, _rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let (gains, biases) = params.split_at_mut(self.fields);
        gains.fill(T::from_f64(gain));
        biases.fill(T::ZERO);
    }

    fn run_forward(&self, params: &[T], x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let group = self.statistics_len(x.len());
        for (inputs, outputs) in x.chunks(group).zip(y.chunks_mut(group)) {
            for first in (0..self.fields).step_by(FIELDS_AT_ONCE) {
                self.forward_fields(params, first, inputs, outputs);
            }
        }
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        let group = self.statistics_len(args.x.len());
        let groups = args.x.chunks(group).zip(args.dy.chunks(group));
        let mut dx = args.dx;
        for (i, (x, dy)) in groups.enumerate() {
            let values = InputsAndGradients { x, dy };
            for first in (0..self.fields).step_by(FIELDS_AT_ONCE) {
                let dx = dx.as_deref_mut().map(|dx| &mut dx[i * group..][..x.len()]);
                self.backward_fields(args.params, first, values, dx, args.dparams);
            }
        }
    }
}

/// Prints fixed mean and variance to the last bit, since files of networks are compared by this
/// text.
impl fmt::Display for FieldNorm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let statistics = match self.statistics {
            NormStatistics::PerSample => "statistics of each sample",
            NormStatistics::Batch => "statistics of the batch",
            NormStatistics::Fixed(_) => "fixed statistics",
        };
        let (shape, fields) = (self.shape, self.fields);
        write!(f, "FieldNorm({shape}, {fields} fields, {statistics})")?;
        match &self.statistics {
            NormStatistics::Fixed(moments) => write!(f, " {moments:?}"),
            _ => Ok(()),
        }
    }
}

/// Returns examples of [`FieldNorm`] for the tests that run on every kind of layer.
pub(super) fn sample_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let norm = |fields, statistics| FieldNorm::new(Shape::image(3, 2, fields), statistics);
    let regular = |n| group.regular_type(n);
    let fixed = NormStatistics::Fixed(vec![[0.3, 2.0], [-1.0, 0.5], [0.0, 1.0]]);
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    // only trivial channels have a mean; under C1 all channels are trivial
    let trivial = mixed.multiplicity(Irrep::Trivial);
    let mean = |f| if f < trivial { 0.7 } else { 0.0 };
    // the mixed type is regular under one of the flips
    let fields = mixed.num_regular_fields().unwrap_or(mixed.dim());
    let moments = (0..fields).map(|f| [mean(f), 0.5 + f as f64]);
    let fixed_mixed = norm(mixed, NormStatistics::Fixed(moments.collect()))?;
    let samples = norm(regular(3), NormStatistics::PerSample)?;
    Ok(vec![
        TestLayer::approximate("norm of a batch", norm(regular(9), NormStatistics::Batch)?),
        TestLayer::approximate("norm of samples", samples),
        TestLayer::approximate("norm of mixed", norm(mixed, NormStatistics::Batch)?),
        TestLayer::approximate("fixed norm", norm(regular(3), fixed)?),
        TestLayer::approximate("fixed norm of mixed", fixed_mixed),
    ])
}

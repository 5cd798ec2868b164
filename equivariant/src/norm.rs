//! Normalisation of fields.

use std::array::from_fn;
use std::fmt;
use std::ops::Range;
use std::slice::ChunksExact;

use rand::Rng;
use symmetry::Irrep;

use crate::{Layer, LayerError, Scalar, Shape};

/// Added to every variance.
const EPSILON: f64 = 1e-5;
/// Fields that are treated together: their sums live on the stack.
const BLOCK: usize = 8;

/// Whose mean and variance a [`FieldNorm`] uses.
#[derive(Clone, Debug, PartialEq)]
pub enum Statistics {
    /// Those of each sample alone (Ulyanov et al., "Instance normalization", 2016): the same at training and inference.
    Sample,
    /// Those of all samples of one call of `forward` (Ioffe and Szegedy, "Batch normalization", ICML 2015). In a
    /// minibatch that runs in chunks that is the chunk: ghost batch normalisation (Hoffer et al.,
    /// NeurIPS 2017, section 4). Chunks are fixed, so the result does not depend on threads.
    Batch,
    /// Fixed ones, `[mean, variance]` per field, such as [`FieldNorm::moments`] of training data: for inference
    /// after training with `Batch`.
    Fixed(Vec<[f64; 2]>),
}

/// Normalises every field to mean 0 and variance 1 over the group, space and samples, then scales and shifts it.
///
/// For regular fields, mean and variance are those of the values in the regular basis. In the
/// irrep basis the mean is the trivial coefficient's and the transform is orthonormal, so no change of basis
/// is needed: with G coefficients c_a a field, mu = E c_0 and var = (sum_a E c_a^2 - mu^2) / G, and
/// y_a = gain (c_a - mu \[a = 0\]) / sqrt(var + 1e-5) + bias \[a = 0\].
///
/// In other types every channel is a field of its own. Channels of odd irreps have mean 0 over the group and
/// are only scaled. The parameters are one gain per field, then one bias per trivial channel, in
/// units of its coefficient.
#[derive(Clone, Debug)]
pub struct FieldNorm {
    shape: Shape,
    /// Channels of a field; the channels of field f are f, f + fields, f + 2 fields ...
    order: usize,
    fields: usize,
    statistics: Statistics,
}

impl FieldNorm {
    /// The normalisation of maps of this shape.
    ///
    /// # Errors
    /// When fixed statistics are not one finite mean and one variance of at least 0 per field.
    pub fn new(shape: Shape, statistics: Statistics) -> Result<FieldNorm, LayerError> {
        let (order, fields) = match shape.fields.regular_fields() {
            Some(fields) => (shape.fields.group().order(), fields),
            None => (1, shape.fields.dim()),
        };
        if let Statistics::Fixed(moments) = &statistics {
            let valid = |[mean, variance]: &[f64; 2]| {
                mean.is_finite() && variance.is_finite() && *variance >= 0.0
            };
            if moments.len() != fields || !moments.iter().all(valid) {
                return Err(LayerError::Setting {
                    layer: "FieldNorm",
                    setting: "fixed statistics",
                    got: format!("{moments:?}"),
                    expected: "a finite mean and a variance of at least 0 for each field",
                });
            }
        }
        Ok(FieldNorm {
            shape,
            order,
            fields,
            statistics,
        })
    }

    /// `[mean, variance]` of every field over all samples of `x`, in units of [`Statistics::Fixed`].
    ///
    /// # Panics
    /// When `x` is not whole samples.
    pub fn moments<T: Scalar>(&self, x: &[T]) -> Vec<[f64; 2]> {
        self.shape.samples(x.len());
        let blocks = (0..self.fields).step_by(BLOCK);
        let moments = blocks.flat_map(|first| self.measure(x, first));
        moments.take(self.fields).collect()
    }

    /// Whether a field has a trivial channel, hence a mean and a bias.
    fn centred(&self, field: usize) -> bool {
        field < self.shape.fields.multiplicity(Irrep::Trivial)
    }

    /// The channels of a block's fields, one range per coefficient; only those of the first are trivial.
    fn channels(&self, first: usize) -> impl Iterator<Item = (usize, Range<usize>)> + use<> {
        let (fields, end) = (self.fields, self.fields.min(first + BLOCK));
        (0..self.order).map(move |a| (a, a * fields + first..a * fields + end))
    }

    fn pixels<'a, T>(&self, x: &'a [T]) -> ChunksExact<'a, T> {
        x.chunks_exact(self.shape.fields.dim().max(1))
    }

    /// `[mean, variance]` of the fields of a block, in double precision.
    fn measure<T: Scalar>(&self, x: &[T], first: usize) -> [[f64; 2]; BLOCK] {
        let pixels = self.pixels(x).len().max(1) as f64;
        let mut moments = [[0.0; 2]; BLOCK];
        for pixel in self.pixels(x) {
            for ([mean, _], v) in moments.iter_mut().zip(&pixel[first..]) {
                *mean += v.to_f64() / pixels;
            }
        }
        for (j, [mean, _]) in moments.iter_mut().enumerate() {
            *mean = if self.centred(first + j) { *mean } else { 0.0 };
        }
        let count = pixels * self.order as f64;
        for pixel in self.pixels(x) {
            for (a, channels) in self.channels(first) {
                for ([mean, variance], v) in moments.iter_mut().zip(&pixel[channels]) {
                    let centre = if a == 0 { *mean } else { 0.0 };
                    *variance += (v.to_f64() - centre).powi(2) / count;
                }
            }
        }
        moments
    }

    /// Means and inverse standard deviations of a block.
    fn standard<T: Scalar>(&self, x: &[T], first: usize) -> [[T; 2]; BLOCK] {
        let moments = match &self.statistics {
            Statistics::Fixed(moments) => {
                from_fn(|j| moments.get(first + j).copied().unwrap_or_default())
            }
            _ => self.measure(x, first),
        };
        moments.map(|[mean, variance]| [mean, (variance + EPSILON).sqrt().recip()].map(T::from_f64))
    }

    /// The number of values that share statistics.
    fn group(&self, len: usize) -> usize {
        match self.statistics {
            Statistics::Sample => self.shape.len().max(1),
            _ => len.max(1),
        }
    }

    /// The gains and the biases of the parameters.
    fn split<'a, T>(&self, params: &'a [T]) -> (&'a [T], &'a [T]) {
        params.split_at(self.fields)
    }

    /// Writes the normalised fields of a block.
    fn normalise<T: Scalar>(&self, params: &[T], first: usize, x: &[T], y: &mut [T]) {
        let (gains, biases) = self.split(params);
        let standard = self.standard(x, first);
        let dim = self.shape.fields.dim().max(1);
        for (x, y) in self.pixels(x).zip(y.chunks_exact_mut(dim)) {
            for (a, channels) in self.channels(first) {
                let values = x[channels.clone()].iter().zip(&mut y[channels]);
                for (j, (&x, y)) in values.enumerate() {
                    let [mean, inverse] = standard[j];
                    *y = match a {
                        0 => gains[first + j] * (x - mean) * inverse,
                        _ => gains[first + j] * x * inverse,
                    };
                    if a == 0 && self.centred(first + j) {
                        *y += biases[first + j];
                    }
                }
            }
        }
    }

    /// Sums over a block of dy times the normalised input, and of dy in trivial channels.
    fn sums<T: Scalar>(
        &self,
        standard: &[[T; 2]; BLOCK],
        first: usize,
        x: &[T],
        dy: &[T],
    ) -> [[f64; 2]; BLOCK] {
        let mut sums = [[0.0; 2]; BLOCK];
        for (x, dy) in self.pixels(x).zip(self.pixels(dy)) {
            for (a, channels) in self.channels(first) {
                let values = x[channels.clone()].iter().zip(&dy[channels]);
                for (j, (&x, &dy)) in values.enumerate() {
                    let [mean, inverse] = standard[j];
                    let centre = if a == 0 { mean } else { T::ZERO };
                    sums[j][0] += ((x - centre) * inverse * dy).to_f64();
                    if a == 0 && self.centred(first + j) {
                        sums[j][1] += dy.to_f64();
                    }
                }
            }
        }
        sums
    }

    /// The gradients of a block: those of its parameters are added, that of its input is written.
    fn differentiate<T: Scalar>(
        &self,
        params: &[T],
        first: usize,
        (x, dy): (&[T], &[T]),
        dx: Option<&mut [T]>,
        dparams: &mut [T],
    ) {
        let standard = self.standard(x, first);
        let sums = self.sums(&standard, first, x, dy);
        for (j, [scaled, trivial]) in sums.iter().enumerate().take(self.fields - first) {
            dparams[first + j] += T::from_f64(*scaled);
            if self.centred(first + j) {
                dparams[self.fields + first + j] += T::from_f64(*trivial);
            }
        }
        let Some(dx) = dx else { return };
        let pixels = self.pixels(x).len() as f64;
        let through = match self.statistics {
            // fixed statistics do not depend on the input
            Statistics::Fixed(_) => [[T::ZERO; 2]; BLOCK],
            _ => sums.map(|[scaled, trivial]| {
                [scaled / (pixels * self.order as f64), trivial / pixels].map(T::from_f64)
            }),
        };
        let dim = self.shape.fields.dim().max(1);
        let inputs = self.pixels(x).zip(self.pixels(dy));
        for ((x, dy), dx) in inputs.zip(dx.chunks_exact_mut(dim)) {
            for (a, channels) in self.channels(first) {
                let values = x[channels.clone()].iter().zip(&dy[channels.clone()]);
                for (j, ((&x, &dy), dx)) in values.zip(&mut dx[channels]).enumerate() {
                    let ([mean, inverse], [scaled, trivial]) = (standard[j], through[j]);
                    let (centre, shift) = if a == 0 {
                        (mean, trivial)
                    } else {
                        (T::ZERO, T::ZERO)
                    };
                    let scale = params[first + j] * inverse;
                    *dx = scale * (dy - (x - centre) * inverse * scaled - shift);
                }
            }
        }
    }
}

impl<T: Scalar> Layer<T> for FieldNorm {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        self.shape
    }

    fn num_params(&self) -> usize {
        self.fields + self.shape.fields.multiplicity(Irrep::Trivial)
    }

    /// Sets the gains to `gain`, which draws nothing, and the biases to zero.
    fn init_scaled(&self, _rng: &mut dyn Rng, gain: f64, params: &mut [T]) {
        let (gains, biases) = params.split_at_mut(self.fields);
        gains.fill(T::from_f64(gain));
        biases.fill(T::ZERO);
    }

    fn forward(&self, params: &[T], x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let group = self.group(x.len());
        for (x, y) in x.chunks(group).zip(y.chunks_mut(group)) {
            for first in (0..self.fields).step_by(BLOCK) {
                self.normalise(params, first, x, y);
            }
        }
    }

    fn backward(
        &self,
        params: &[T],
        x: &[T],
        _y: &[T],
        dy: &[T],
        mut dx: Option<&mut [T]>,
        dparams: &mut [T],
        _scratch: &mut [T],
    ) {
        let group = self.group(x.len());
        for (i, values) in x.chunks(group).zip(dy.chunks(group)).enumerate() {
            for first in (0..self.fields).step_by(BLOCK) {
                let dx = dx.as_deref_mut();
                let dx = dx.map(|dx| &mut dx[i * group..][..values.0.len()]);
                self.differentiate(params, first, values, dx, dparams);
            }
        }
    }
}

impl fmt::Display for FieldNorm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FieldNorm({}, {} fields)", self.shape, self.fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FieldType, hadamard};
    use symmetry::Group;

    fn waves(len: usize) -> Vec<f64> {
        (0..len)
            .map(|i| 0.5 + (i as f64 * 1.7).sin() + i as f64 * 0.01)
            .collect()
    }

    fn normalised(layer: &FieldNorm, x: &[f64]) -> Vec<f64> {
        let params = [vec![1.0; layer.fields], vec![0.0; layer.fields]].concat();
        let mut y = vec![f64::NAN; x.len()];
        layer.forward(&params, x, &mut y, &mut []);
        y
    }

    /// Mean and variance of field `f` of `fields` in the regular basis.
    fn regular_moments(group: Group, fields: usize, f: usize, y: &[f64]) -> [f64; 2] {
        let mut values = Vec::new();
        for pixel in y.chunks(group.order() * fields) {
            let mut pixel = pixel.to_vec();
            hadamard(group, &mut pixel);
            values.extend(pixel.into_iter().skip(f).step_by(fields));
        }
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        [mean, variance / values.len() as f64]
    }

    #[test]
    fn fields_have_mean_zero_and_variance_one_over_group_space_and_samples() {
        for group in Group::ALL {
            let shape = Shape::image(3, 4, group.regular(9));
            let x = waves(5 * shape.len());
            let batch = FieldNorm::new(shape, Statistics::Batch).unwrap();
            let y = normalised(&batch, &x);
            let sample = FieldNorm::new(shape, Statistics::Sample).unwrap();
            let alone = normalised(&sample, &x);
            for f in 0..9 {
                for y in shape.each(&alone).chain([&y[..]]) {
                    let [mean, variance] = regular_moments(group, 9, f, y);
                    assert!(
                        mean.abs() < 1e-12 && (variance - 1.0).abs() < 1e-3,
                        "{group}"
                    );
                }
            }
        }
    }

    #[test]
    fn fixed_moments_of_the_batch_do_what_the_batch_does() {
        let shape = Shape::image(2, 3, FieldType::new(Group::D2, [2, 1, 0, 3]));
        let x = waves(4 * shape.len());
        let batch = FieldNorm::new(shape, Statistics::Batch).unwrap();
        let moments = batch.moments(&x);
        assert!(moments[..2].iter().all(|m| m[0] != 0.0));
        assert!(
            moments[2..].iter().all(|m| m[0] == 0.0),
            "odd channels are not centred"
        );
        let fixed = FieldNorm::new(shape, Statistics::Fixed(moments)).unwrap();
        assert_eq!(normalised(&batch, &x), normalised(&fixed, &x));
    }

    #[test]
    fn statistics_that_do_not_fit_are_refused() {
        let shape = Shape::vector(Group::D2.regular(2));
        for wrong in [
            vec![[0.0, 1.0]],
            vec![[0.0, -1.0]; 2],
            vec![[f64::NAN, 1.0]; 2],
        ] {
            let error = FieldNorm::new(shape, Statistics::Fixed(wrong)).unwrap_err();
            assert!(
                error
                    .to_string()
                    .starts_with("FieldNorm: got the fixed statistics [[")
            );
        }
    }
}

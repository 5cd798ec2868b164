//! Spatial soft-argmax: maps to keypoints.

use std::fmt;

use symmetry::{FieldType, Group, Irrep};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerKind, LayerSignature, Parameterless, Scalar, hash_of};
use crate::real::exceeds_or_is_nan;
use crate::shape::Shape;
use crate::steerable::hadamard::{hadamard_transform_pixels, require_permuted_fields};

/// Layer that computes the expected position of every map under the softmax over its pixels.
///
/// Each channel in the regular basis is divided by the temperature and turned into a distribution
/// over the pixels; its mean (x, y) is a keypoint (Levine et al., "End-to-end training of deep
/// visuomotor policies", JMLR 2016, section 5.1). x grows to the right and y upwards; the image's
/// edges are at -1 and 1.
///
/// An element g permutes the channels of a regular field and negates the coordinates that it flips:
/// keypoints transform as regular x (x + y). Multiplying the value at element h by the sign x(h),
/// or y(h), makes that a regular field again, so n regular fields become 2 n, those of x before
/// those of y. n trivial channels become n channels of irrep x and n of irrep y.
#[derive(Clone, Copy, Debug)]
pub struct SpatialSoftArgmax {
    shape: Shape,
    order: usize,
    fields: usize,
    temperature: f64,
}

impl SpatialSoftArgmax {
    /// Creates the layer for maps of this shape and a softmax of this temperature. 1 is the usual
    /// temperature; lower ones are closer to the maximum.
    ///
    /// # Errors
    /// When the map is empty, its type is neither regular fields only nor trivial channels only, it
    /// has more than 2^23 channels, or the temperature or its reciprocal is not a positive, finite
    /// and normal number in single precision.
    pub fn new(shape: Shape, temperature: f64) -> Result<SpatialSoftArgmax, LayerError> {
        let (order, fields) = require_permuted_fields("SpatialSoftArgmax", shape)?;
        LayerError::check_channels("SpatialSoftArgmax", 2 * shape.fields.dim())?;
        // the passes use the reciprocal, in either precision
        let usable = [temperature as f32, temperature.recip() as f32];
        if !usable.iter().all(|t| t.is_normal() && *t > 0.0) {
            return Err(LayerError::InvalidSetting {
                layer: "SpatialSoftArgmax",
                setting: "temperature",
                got: temperature.to_string(),
                expected: "a number above 0 that is finite in single precision, as is its reciprocal",
            });
        }
        Ok(SpatialSoftArgmax { shape, order, fields, temperature })
    }

    /// Returns the field type of the output, the vector of keypoint coordinates.
    fn out_type(&self) -> FieldType {
        let (group, n) = (self.shape.fields.group(), self.fields);
        match self.order {
            1 => FieldType::new(group, [0, n, n, 0]),
            _ => group.regular_type(2 * n),
        }
    }

    /// Returns the position `[x, y]` of a pixel's centre, in [-1, 1].
    fn position<T: Scalar>(&self, pixel: usize) -> [T; 2] {
        let Shape { height, width, .. } = self.shape;
        // centres of pixels, for edges at -1 and 1; rows count downwards, y upwards
        let centred = |at: usize, size: usize| (2.0 * at as f64 + 1.0 - size as f64) / size as f64;
        [T::from_f64(centred(pixel % width, width)), T::from_f64(-centred(pixel / width, height))]
    }

    /// Returns the output channel of the keypoint coordinate x (0) or y (1) of a channel of the
    /// regular basis, and the sign of the coordinate there.
    fn keypoint_channel(&self, channel: usize, coordinate: usize) -> (usize, i8) {
        let (n, irrep) = (self.fields, [Irrep::X, Irrep::Y][coordinate]);
        let group = self.shape.fields.group();
        if self.order == 1 {
            let range = self.out_type().channel_range(group.restrict_irrep(irrep));
            // under C1 and C2, x and y are the same irrep, and x comes first
            let place = if coordinate == 0 { range.start } else { range.end - n };
            return (place + channel, 1);
        }
        let (element, field) = (channel / n, channel % n);
        let place = element * 2 * n + coordinate * n + field;
        (place, irrep.sign(group.elements()[element]))
    }

    fn transform_input<T: Scalar>(&self, values: &mut [T]) {
        hadamard_transform_pixels(self.order, self.fields, values);
    }

    fn transform_output<T: Scalar>(&self, values: &mut [T]) {
        hadamard_transform_pixels(self.order, 2 * self.fields, values);
    }

    /// Converts the output fields `y` of one sample to the keypoints of the `dim` channels in the
    /// regular basis, x of all and then y of all, `[2 dim]`; `spare` has the same length.
    fn keypoints<T: Scalar>(&self, y: &[T], spare: &mut [T], keypoints: &mut [T]) {
        spare.copy_from_slice(y);
        self.transform_output(spare);
        let dim = self.shape.fields.dim();
        for (i, keypoint) in keypoints[..2 * dim].iter_mut().enumerate() {
            let (place, sign) = self.keypoint_channel(i % dim, i / dim);
            *keypoint = if sign < 0 { -spare[place] } else { spare[place] };
        }
    }

    /// Turns the channels `[H, W, dim]` of one sample into distributions over the pixels, in place.
    fn softmax<T: Scalar>(&self, map: &mut [T], row: &mut [T]) {
        let dim = row.len();
        // subtracting the maximum leaves the softmax unchanged and keeps exp from overflowing
        channel_maxima(map, row);
        let inverse = T::from_f64(self.temperature.recip());
        for pixel in map.chunks_exact_mut(dim) {
            for (v, &best) in pixel.iter_mut().zip(&*row) {
                *v = ((*v - best) * inverse).exp();
            }
        }
        row.fill(T::ZERO);
        for pixel in map.chunks_exact(dim) {
            for (sum, &v) in row.iter_mut().zip(pixel) {
                *sum += v;
            }
        }
        for pixel in map.chunks_exact_mut(dim) {
            for (v, &sum) in pixel.iter_mut().zip(&*row) {
                *v /= sum;
            }
        }
    }

    /// Writes the expected pixel position of the `dim` channels: x of all, then y of all, `[2
    /// dim]`.
    fn expected_positions<T: Scalar>(&self, map: &[T], means: &mut [T]) {
        means.fill(T::ZERO);
        let (x_means, y_means) = means.split_at_mut(means.len() / 2);
        for (i, pixel) in map.chunks_exact(x_means.len()).enumerate() {
            let [x, y] = self.position::<T>(i);
            for ((x_mean, y_mean), &p) in x_means.iter_mut().zip(&mut *y_means).zip(pixel) {
                *x_mean += p * x;
                *y_mean += p * y;
            }
        }
    }

    /// Writes the gradient with respect to the input channels in the regular basis, from the
    /// softmax distributions, the keypoints and the keypoints' gradient. The last two are in the
    /// layout of [`keypoints`](SpatialSoftArgmax::keypoints).
    fn gradient<T: Scalar>(&self, map: &[T], means: &[T], gradients: &[T], dx: &mut [T]) {
        let dim = self.shape.fields.dim();
        let inverse = T::from_f64(self.temperature.recip());
        let pixels = map.chunks_exact(dim).zip(dx.chunks_exact_mut(dim));
        for (i, (p, out)) in pixels.enumerate() {
            let [x, y] = self.position::<T>(i);
            for c in 0..dim {
                let along_x = (x - means[c]) * gradients[c];
                let along_y = (y - means[dim + c]) * gradients[dim + c];
                out[c] = p[c] * inverse * (along_x + along_y);
            }
        }
    }
}

/// Writes the largest value of every channel of a map over the pixels.
fn channel_maxima<T: Scalar>(map: &[T], row: &mut [T]) {
    row.copy_from_slice(&map[..row.len()]);
    for pixel in map.chunks_exact(row.len()) {
        for (best, &v) in row.iter_mut().zip(pixel) {
            *best = if exceeds_or_is_nan(v, *best) { v } else { *best };
        }
    }
}

impl LayerSignature for SpatialSoftArgmax {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        Shape::vector(self.out_type())
    }

    /// Returns the length of the scratch memory: softmax distributions of all samples and three
    /// vectors of keypoint coordinates.
    fn scratch_len(&self, samples: usize) -> usize {
        samples * self.shape.len() + 6 * self.shape.fields.dim()
    }

    fn keeps_scratch(&self) -> bool {
        true
    }

    fn scratch_key(&self) -> u64 {
        hash_of(("SpatialSoftArgmax", self.shape, self.temperature.to_bits()))
    }
}

impl Parameterless for SpatialSoftArgmax {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::SpatialSoftArgmax { temperature: self.temperature }
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]) {
        let dim = self.shape.fields.dim();
        let (distributions, rows) = scratch.split_at_mut(x.len());
        distributions.copy_from_slice(x);
        let maps = self.shape.samples_mut(distributions);
        for (map, keypoints) in maps.zip(y.chunks_exact_mut(2 * dim)) {
            self.transform_input(map);
            self.softmax(map, &mut rows[..dim]);
            let means = &mut rows[..2 * dim];
            self.expected_positions(map, means);
            for (i, &mean) in means.iter().enumerate() {
                let (place, sign) = self.keypoint_channel(i % dim, i / dim);
                keypoints[place] = if sign < 0 { -mean } else { mean };
            }
            self.transform_output(keypoints);
        }
    }

    fn backprop<T: Scalar>(&self, _x: &[T], y: &[T], dy: &[T], dx: &mut [T], scratch: &mut [T]) {
        let dim = self.shape.fields.dim();
        let (distributions, rows) = scratch.split_at_mut(dx.len());
        let (spare, rows) = rows.split_at_mut(2 * dim);
        let (means, gradients) = rows.split_at_mut(2 * dim);
        let maps = self.shape.samples(distributions);
        let (ys, dys) = (y.chunks_exact(2 * dim), dy.chunks_exact(2 * dim));
        for ((map, (points, upstream)), gradient) in
            maps.zip(ys.zip(dys)).zip(self.shape.samples_mut(dx))
        {
            self.keypoints(points, spare, means);
            self.keypoints(upstream, spare, gradients);
            self.gradient(map, means, gradients, gradient);
            self.transform_input(gradient);
        }
    }
}

impl fmt::Display for SpatialSoftArgmax {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from, to, temperature) = (self.shape, self.out_type(), self.temperature);
        write!(f, "SpatialSoftArgmax({from} -> {to}, temperature {temperature})")
    }
}

/// Returns examples of [`SpatialSoftArgmax`] for the tests that run on every kind of layer.
pub(super) fn sample_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let regular = Shape::image(4, 5, group.regular_type(3));
    let trivial = Shape::image(3, 3, group.trivial_type(2));
    let trivial = SpatialSoftArgmax::new(trivial, 1.0)?;
    Ok(vec![
        TestLayer::approximate("soft-argmax", SpatialSoftArgmax::new(regular, 0.5)?),
        TestLayer::approximate("trivial soft-argmax", trivial),
    ])
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::layers::layer::Layer;
    use crate::scratch::Scratch;

    fn keypoints(group: Group, size: [usize; 2], x: &[f64], temperature: f64) -> Vec<f64> {
        let channels = x.len() / (size[0] * size[1]);
        let shape = Shape::image(size[0], size[1], group.trivial_type(channels));
        let layer = SpatialSoftArgmax::new(shape, temperature).unwrap();
        let mut y = vec![f64::NAN; 2 * channels];
        let mut scratch = Scratch::filled_with(layer.scratch_len(1), f64::NAN);
        layer.forward(&[], x, &mut y, &mut scratch);
        y
    }

    #[test]
    fn a_cold_softmax_finds_the_brightest_pixel() {
        let mut image = [0.0; 12];
        image[4 + 3] = 1.0;
        // row 1 of 3 is the middle, column 3 of 4 has its centre at 3/4 of the half width
        for group in Group::ALL {
            let mut found = keypoints(group, [3, 4], &image, 1e-3);
            if group == Group::D1x {
                // y is invariant there and comes first
                found.reverse();
            }
            assert!((found[0] - 0.75).abs() < 1e-12 && found[1].abs() < 1e-12);
        }
        image[0] = 2.0;
        let found = keypoints(Group::D2, [3, 4], &image, 1e-3);
        assert!((found[0] + 0.75).abs() < 1e-12 && (found[1] - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn regular_fields_give_twice_as_many() {
        let out = |fields: FieldType| {
            let layer = SpatialSoftArgmax::new(Shape::image(4, 4, fields), 1.0).unwrap();
            layer.out_shape().fields
        };
        for group in Group::ALL {
            assert_eq!(out(group.regular_type(3)), group.regular_type(6));
        }
        assert_eq!(out(Group::D2.trivial_type(3)).to_string(), "3 x + 3 y");
        assert_eq!(out(Group::D1y.trivial_type(3)).to_string(), "D1y: 3 reg");
        assert_eq!(out(Group::C2.trivial_type(3)).to_string(), "C2: 6 x");
    }

    #[test]
    fn temperatures_that_give_what_is_not_finite_are_refused() {
        let shape = Shape::image(2, 3, Group::D2.regular_type(1));
        for temperature in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-39, 1e39, 1e300] {
            let error = SpatialSoftArgmax::new(shape, temperature).unwrap_err();
            let message = error.to_string();
            let expected = format!("got the temperature {temperature}, expected a number above 0");
            assert!(message.contains(&expected), "{message}");
        }
    }

    #[test]
    fn extreme_temperatures_give_finite_keypoints_and_gradients() {
        let shape = Shape::image(2, 3, Group::D2.trivial_type(1));
        for temperature in [1e-37, 1e37] {
            let layer = SpatialSoftArgmax::new(shape, temperature).unwrap();
            let (mut y, mut dx) = ([0.0f32; 2], [0.0f32; 6]);
            let mut scratch = layer.allocate_scratch(1);
            let x = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
            layer.forward(&[], &x, &mut y, &mut scratch);
            let dy = [1.0, 1.0];
            layer.backward(&[], &x, &y, &dy, Some(&mut dx), &mut [], &mut scratch);
            assert!(y.iter().chain(&dx).all(|v| v.is_finite()), "{y:?} {dx:?}");
        }
    }
}

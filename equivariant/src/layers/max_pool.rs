//! Spatial max-pooling.

use std::fmt;

use symmetry::Group;

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerKind, LayerSignature, Parameterless, Scalar};
use crate::real::exceeds_or_is_nan;
use crate::shape::Shape;
use crate::steerable::hadamard::{hadamard_transform_pixels, require_permuted_fields};
use crate::steerable::windows::WindowGrid;
use crate::window::SlidingWindow;

/// Layer that takes the maximum over a sliding window of pixels, for every channel in the regular
/// basis.
///
/// The group permutes pixels and the channels of the regular basis, so the map is exactly
/// equivariant if the windows sit symmetrically. Padding is never the maximum. On ties the gradient
/// goes to the first pixel, row-major. Trivial channels are pooled as they are.
#[derive(Clone, Copy, Debug)]
pub struct MaxPool {
    shape: Shape,
    order: usize,
    fields: usize,
    windows: WindowGrid,
}

impl MaxPool {
    /// Creates the max-pooling of maps of this shape.
    ///
    /// # Errors
    /// When the map is empty, its type is neither regular fields only nor trivial channels only,
    /// the windows do not sit symmetrically (see [`SlidingWindow`]), none fits, or the padding
    /// exceeds half a window.
    pub fn new(shape: Shape, kernel: SlidingWindow) -> Result<MaxPool, LayerError> {
        let (order, fields) = require_permuted_fields("MaxPool", shape)?;
        Ok(MaxPool {
            shape,
            order,
            fields,
            windows: WindowGrid::for_pooling("MaxPool", shape, kernel)?,
        })
    }

    /// Transforms pixels between the irrep basis and the regular basis.
    fn transform<T: Scalar>(&self, values: &mut [T]) {
        hadamard_transform_pixels(self.order, self.fields, values);
    }

    /// Writes the maximum of each of the `dim` channels over pooling window `index` into `y`.
    fn window_maximum<T: Scalar>(&self, regular: &[T], index: usize, y: &mut [T]) {
        let dim = y.len();
        let mut pixels = self.windows.pixels_in_window(index);
        if let Some(first) = pixels.next() {
            y.copy_from_slice(&regular[first * dim..][..dim]);
        }
        for pixel in pixels {
            for (largest, &x) in y.iter_mut().zip(&regular[pixel * dim..]) {
                *largest = if exceeds_or_is_nan(x, *largest) { x } else { *largest };
            }
        }
    }

    /// Adds the output gradient `dy` of pooling window `index` to the first pixel that holds the
    /// maximum of each channel, and overwrites `dy`.
    fn scatter_to_maximum<T: Scalar>(
        &self,
        regular: &[T],
        index: usize,
        y: &[T],
        dy: &mut [T],
        dx: &mut [T],
    ) {
        let dim = y.len();
        for pixel in self.windows.pixels_in_window(index) {
            let (x, dx) = (&regular[pixel * dim..][..dim], &mut dx[pixel * dim..][..dim]);
            for c in 0..dim {
                // the winner takes dy and leaves zero for later pixels of equal value
                let hit = x[c] == y[c];
                dx[c] += if hit { dy[c] } else { T::ZERO };
                dy[c] = if hit { T::ZERO } else { dy[c] };
            }
        }
    }
}

impl LayerSignature for MaxPool {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        self.windows.out_shape(self.shape.fields)
    }

    /// Returns the length of the scratch memory: one image in the regular basis, and two of its
    /// pixels.
    fn scratch_len(&self, _samples: usize) -> usize {
        self.shape.len() + 2 * self.shape.fields.dim()
    }
}

impl Parameterless for MaxPool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::MaxPool(self.windows.window)
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], scratch: &mut [T]) {
        let regular = &mut scratch[..self.shape.len()];
        for (map, pooled) in self.shape.samples(x).zip(self.out_shape().samples_mut(y)) {
            regular.copy_from_slice(map);
            self.transform(regular);
            let pixels = pooled.chunks_exact_mut(self.shape.fields.dim());
            for (i, out) in pixels.enumerate() {
                self.window_maximum(regular, i, out);
            }
            self.transform(pooled);
        }
    }

    fn backprop<T: Scalar>(&self, x: &[T], _y: &[T], dy: &[T], dx: &mut [T], scratch: &mut [T]) {
        let dim = self.shape.fields.dim();
        let (regular, pixel) = scratch.split_at_mut(self.shape.len());
        // the maxima are computed again: y was rounded by two transforms, and would not equal a
        // pixel
        let (y, gradient) = pixel[..2 * dim].split_at_mut(dim);
        let inputs = self.shape.samples(x).zip(self.out_shape().samples(dy));
        for ((map, upstream), map_gradient) in inputs.zip(self.shape.samples_mut(dx)) {
            regular.copy_from_slice(map);
            self.transform(regular);
            map_gradient.fill(T::ZERO);
            for (i, pixel_dy) in upstream.chunks_exact(dim).enumerate() {
                self.window_maximum(regular, i, y);
                gradient.copy_from_slice(pixel_dy);
                self.transform(gradient);
                self.scatter_to_maximum(regular, i, y, gradient, map_gradient);
            }
            self.transform(map_gradient);
        }
    }
}

impl fmt::Display for MaxPool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.windows.fmt_pooling(f, "MaxPool", self.shape.fields)
    }
}

/// Returns examples of [`MaxPool`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let pool = |height, width, fields, [size, stride, padding]: [usize; 3]| {
        let kernel = SlidingWindow::new(size, stride, padding);
        MaxPool::new(Shape::image(height, width, fields), kernel)
    };
    let regular = |n| group.regular_type(n);
    let trivial = pool(4, 4, group.trivial_type(3), [2, 2, 0])?;
    Ok(vec![
        TestLayer::exact("max-pool 2x2/2", pool(4, 6, regular(3), [2, 2, 0])?),
        TestLayer::exact("max-pool 3x3/2", pool(5, 3, regular(2), [3, 2, 1])?),
        TestLayer::exact("trivial max-pool", trivial),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use symmetry::Group;

    #[test]
    fn padding_never_wins_and_not_a_number_always_does() {
        let kernel = SlidingWindow::new(3, 1, 1);
        let pool = MaxPool::new(Shape::image(1, 3, Group::D2.trivial_type(1)), kernel).unwrap();
        let (mut y, mut scratch) = ([0.0f64; 3], pool.allocate_scratch(1));
        pool.forward(&[], &[-3.0, -2.0, -5.0], &mut y, &mut scratch);
        assert_eq!(y, [-2.0, -2.0, -2.0]);
        pool.forward(&[], &[f64::NAN, -2.0, -5.0], &mut y, &mut scratch);
        assert!(y[0].is_nan() && y[1].is_nan() && y[2] == -2.0);
    }
}

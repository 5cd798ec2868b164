//! Spatial average-pooling.

use std::fmt;

use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerKind, LayerSignature, Parameterless, Scalar};
use crate::shape::Shape;
use crate::steerable::windows::WindowGrid;
use crate::window::SlidingWindow;

/// Layer that averages over a sliding window of pixels, channel by channel, for any field type;
/// padding counts as zeros.
#[derive(Clone, Copy, Debug)]
pub struct AveragePool {
    shape: Shape,
    windows: WindowGrid,
}

impl AveragePool {
    /// Creates the average pooling of maps of this shape.
    ///
    /// # Errors
    /// When the map is empty, the windows do not sit symmetrically (see [`SlidingWindow`]), none
    /// fits, or the padding exceeds half a window.
    pub fn new(shape: Shape, kernel: SlidingWindow) -> Result<AveragePool, LayerError> {
        let windows = WindowGrid::for_pooling("AveragePool", shape, kernel)?;
        Ok(AveragePool { shape, windows })
    }

    /// Returns the weight of one pixel in the average: one over the number of pixels of the window.
    fn weight<T: Scalar>(&self) -> T {
        T::from_f64((self.windows.window.size as f64).powi(2).recip())
    }
}

impl LayerSignature for AveragePool {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        self.windows.out_shape(self.shape.fields)
    }
}

impl Parameterless for AveragePool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::AveragePool(self.windows.window)
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let (dim, weight) = (self.shape.fields.dim(), self.weight::<T>());
        y.fill(T::ZERO);
        for (map, pooled) in self.shape.samples(x).zip(self.out_shape().samples_mut(y)) {
            for (i, out) in pooled.chunks_exact_mut(dim).enumerate() {
                for pixel in self.windows.pixels_in_window(i) {
                    for (sum, &value) in out.iter_mut().zip(&map[pixel * dim..]) {
                        *sum += value * weight;
                    }
                }
            }
        }
    }

    fn backprop<T: Scalar>(&self, _x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let (dim, weight) = (self.shape.fields.dim(), self.weight::<T>());
        dx.fill(T::ZERO);
        for (pooled, map) in self.out_shape().samples(dy).zip(self.shape.samples_mut(dx)) {
            for (i, gradient) in pooled.chunks_exact(dim).enumerate() {
                for pixel in self.windows.pixels_in_window(i) {
                    for (sum, &value) in map[pixel * dim..].iter_mut().zip(gradient) {
                        *sum += value * weight;
                    }
                }
            }
        }
    }
}

impl fmt::Display for AveragePool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.windows.fmt_pooling(f, "AveragePool", self.shape.fields)
    }
}

/// Returns examples of [`AveragePool`] for the tests that run on every kind of layer.
pub(super) fn sample_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let mixed = Shape::image(4, 6, FieldType::new(group, [2, 1, 3, 0]));
    let regular = Shape::image(3, 4, group.regular_type(2));
    let halving = AveragePool::new(mixed, SlidingWindow::new(2, 2, 0))?;
    let same = AveragePool::new(regular, SlidingWindow::new(3, 1, 1))?;
    Ok(vec![
        TestLayer::approximate("average-pool 2x2/2", halving),
        TestLayer::approximate("average-pool 3x3", same),
    ])
}

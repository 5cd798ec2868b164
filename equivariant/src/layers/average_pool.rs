//! Spatial average-pooling.

use std::fmt;

use symmetry::{FieldType, Group};

use crate::error::LayerError;
use crate::layers::check::Example;
use crate::layers::layer::{LayerKind, Parameterless, Scalar, Signature};
use crate::shape::Shape;
use crate::steerable::windows::Windows;
use crate::window::Kernel;

/// Layer that averages over a window, channel by channel, for any field type; padding counts as
/// zeros.
#[derive(Clone, Copy, Debug)]
pub struct AveragePool {
    shape: Shape,
    windows: Windows,
}

impl AveragePool {
    /// Creates the average pooling of maps of this shape.
    ///
    /// # Errors
    /// When the map is empty, the windows do not sit symmetrically (see [`Kernel`]), none fits, or
    /// the padding exceeds half a window.
    pub fn new(shape: Shape, kernel: Kernel) -> Result<AveragePool, LayerError> {
        let windows = Windows::of_pooling("AveragePool", shape, kernel)?;
        Ok(AveragePool { shape, windows })
    }

    /// Returns the weight of one pixel.
    fn weight<T: Scalar>(&self) -> T {
        T::from_f64((self.windows.kernel.size as f64).powi(2).recip())
    }
}

impl Signature for AveragePool {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        self.windows.out_shape(self.shape.fields)
    }
}

impl Parameterless for AveragePool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::AveragePool(self.windows.kernel)
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let (dim, weight) = (self.shape.fields.dim(), self.weight::<T>());
        y.fill(T::ZERO);
        for (map, pooled) in self.shape.each(x).zip(self.out_shape().each_mut(y)) {
            for (i, out) in pooled.chunks_exact_mut(dim).enumerate() {
                for pixel in self.windows.pixels(i) {
                    for (sum, &value) in out.iter_mut().zip(&map[pixel * dim..]) {
                        *sum += value * weight;
                    }
                }
            }
        }
    }

    fn pull_back<T: Scalar>(&self, _x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let (dim, weight) = (self.shape.fields.dim(), self.weight::<T>());
        dx.fill(T::ZERO);
        for (pooled, map) in self.out_shape().each(dy).zip(self.shape.each_mut(dx)) {
            for (i, gradient) in pooled.chunks_exact(dim).enumerate() {
                for pixel in self.windows.pixels(i) {
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
        self.windows.write_pooling(f, "AveragePool", self.shape.fields)
    }
}

/// Returns examples for the tests of all layers.
pub(super) fn examples<T: Scalar>(group: Group) -> Result<Vec<Example<T>>, LayerError> {
    let mixed = Shape::image(4, 6, FieldType::new(group, [2, 1, 3, 0]));
    let regular = Shape::image(3, 4, group.regular(2));
    let halving = AveragePool::new(mixed, Kernel::new(2, 2, 0))?;
    let same = AveragePool::new(regular, Kernel::new(3, 1, 1))?;
    Ok(vec![
        Example::rounded("average-pool 2x2/2", halving),
        Example::rounded("average-pool 3x3", same),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use symmetry::Group;

    #[test]
    fn padding_counts_as_zeros() {
        let kernel = Kernel::new(2, 1, 1);
        let pool = AveragePool::new(Shape::image(1, 2, Group::D2.trivial(1)), kernel).unwrap();
        assert_eq!((pool.out_shape().height, pool.out_shape().width), (2, 3));
        let mut y = [f64::NAN; 6];
        pool.forward(&[], &[4.0, 8.0], &mut y, &mut pool.scratch(1));
        assert_eq!(y, [1.0, 3.0, 2.0, 1.0, 3.0, 2.0]);
    }

    #[test]
    fn a_window_that_breaks_the_symmetry_is_refused_by_name() {
        let kernel = Kernel::new(2, 2, 0);
        let shape = Shape::image(4, 5, Group::D1x.regular(1));
        let message = AveragePool::new(shape, kernel).unwrap_err().to_string();
        assert!(message.starts_with("AveragePool: D1x flips the width"), "{message}");
        assert!(message.contains("(5 + 2 * 0 - 2) mod 2 = 1"), "{message}");
    }
}

//! ReLU on regular or trivial fields.

use std::array::from_fn;
use std::fmt;

use symmetry::Group;

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerKind, LayerSignature, Parameterless, Scalar};
use crate::shape::Shape;
use crate::steerable::hadamard::{
    require_permuted_fields, split_by_irrep, split_by_irrep_mut, walsh_hadamard, with_const_order,
};

/// Layer that takes the pointwise max(0, .) in the regular basis.
///
/// The group permutes the regular basis, so a pointwise map there is equivariant: Hadamard
/// transform, ReLU, transform back, all orthonormal. On trivial channels it is the plain ReLU.
#[derive(Clone, Copy, Debug)]
pub struct Relu {
    shape: Shape,
    order: usize,
    fields: usize,
}

impl Relu {
    /// Creates the ReLU of maps of this shape.
    ///
    /// # Errors
    /// When the map is empty or its type is neither regular fields only nor trivial channels only.
    pub fn new(shape: Shape) -> Result<Relu, LayerError> {
        let (order, fields) = require_permuted_fields("Relu", shape)?;
        Ok(Relu { shape, order, fields })
    }
}

impl LayerSignature for Relu {
    fn in_shape(&self) -> Shape {
        self.shape
    }
}

impl Parameterless for Relu {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::Relu
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        with_const_order!(G = self.order, forward_fields::<T, G>(self.fields, x, y));
    }

    fn backprop<T: Scalar>(&self, x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        with_const_order!(G = self.order, backward_fields::<T, G>(self.fields, x, dy, dx));
    }
}

impl fmt::Display for Relu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Relu({})", self.shape)
    }
}

/// Returns zero if `gate` is at most zero, else `value`; a NaN gate passes, so that errors stay
/// visible.
#[inline(always)]
fn relu_gate<T: Scalar>(gate: T, value: T) -> T {
    if gate <= T::ZERO { T::ZERO } else { value }
}

fn forward_fields<T: Scalar, const G: usize>(fields: usize, x: &[T], y: &mut [T]) {
    match fields {
        // constant widths let the compiler vectorise the common cases
        4 => forward_pixels::<T, G>(4, x, y),
        8 => forward_pixels::<T, G>(8, x, y),
        16 => forward_pixels::<T, G>(16, x, y),
        n => forward_pixels::<T, G>(n, x, y),
    }
}

fn backward_fields<T: Scalar, const G: usize>(fields: usize, x: &[T], dy: &[T], dx: &mut [T]) {
    match fields {
        4 => backward_pixels::<T, G>(4, x, dy, dx),
        8 => backward_pixels::<T, G>(8, x, dy, dx),
        16 => backward_pixels::<T, G>(16, x, dy, dx),
        n => backward_pixels::<T, G>(n, x, dy, dx),
    }
}

#[inline(always)]
fn forward_pixels<T: Scalar, const G: usize>(n: usize, x: &[T], y: &mut [T]) {
    let width = (G * n).max(1);
    for (pixel, out) in x.chunks_exact(width).zip(y.chunks_exact_mut(width)) {
        let pixel = split_by_irrep::<T, G>(pixel, n);
        let out = split_by_irrep_mut::<T, G>(out, n);
        for f in 0..n {
            let values = walsh_hadamard::<T, G>(from_fn(|a| pixel[a][f])).map(|v| relu_gate(v, v));
            let values = walsh_hadamard(values);
            for a in 0..G {
                out[a][f] = values[a];
            }
        }
    }
}

#[inline(always)]
fn backward_pixels<T: Scalar, const G: usize>(n: usize, x: &[T], dy: &[T], dx: &mut [T]) {
    let width = (G * n).max(1);
    let inputs = x.chunks_exact(width).zip(dy.chunks_exact(width));
    for ((pixel, upstream), gradient) in inputs.zip(dx.chunks_exact_mut(width)) {
        let (pixel, upstream) =
            (split_by_irrep::<T, G>(pixel, n), split_by_irrep::<T, G>(upstream, n));
        let gradient = split_by_irrep_mut::<T, G>(gradient, n);
        for f in 0..n {
            let gates = walsh_hadamard::<T, G>(from_fn(|a| pixel[a][f]));
            let values = walsh_hadamard::<T, G>(from_fn(|a| upstream[a][f]));
            let values = walsh_hadamard::<T, G>(from_fn(|g| relu_gate(gates[g], values[g])));
            for a in 0..G {
                gradient[a][f] = values[a];
            }
        }
    }
}

/// Returns examples of [`Relu`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let image = Shape::image;
    let trivial = Shape::vector(group.trivial_type(5));
    Ok(vec![
        TestLayer::exact("relu", Relu::new(image(3, 2, group.regular_type(3)))?),
        TestLayer::exact("relu of 8", Relu::new(image(3, 2, group.regular_type(8)))?),
        TestLayer::exact("trivial relu", Relu::new(trivial)?),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use symmetry::Group;

    #[test]
    fn not_a_number_stays_visible() {
        let relu = Relu::new(Shape::vector(Group::D2.trivial_type(2))).unwrap();
        let mut y = [0.0f64; 2];
        relu.forward(&[], &[f64::NAN, -1.0], &mut y, &mut relu.allocate_scratch(1));
        assert!(y[0].is_nan() && y[1] == 0.0);
    }
}

//! Pooling over the group: from regular fields to invariants.

use std::array::from_fn;
use std::fmt;

use symmetry::Group;

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerKind, LayerSignature, Parameterless, Scalar};
use crate::real::exceeds_or_is_nan;
use crate::shape::Shape;
use crate::steerable::hadamard::{
    split_by_irrep, split_by_irrep_mut, walsh_hadamard, with_const_order,
};

/// Layer that takes the maximum of every regular field over the elements of the group.
///
/// Maps n regular fields to n trivial channels: the largest value in the regular basis. On ties the
/// gradient goes to the first group element.
#[derive(Clone, Copy, Debug)]
pub struct GroupMaxPool {
    shape: Shape,
    fields: usize,
}

impl GroupMaxPool {
    /// Creates the pooling over the group for feature maps of this shape.
    ///
    /// # Errors
    /// When the map is empty or its type is not regular fields only.
    pub fn new(shape: Shape) -> Result<GroupMaxPool, LayerError> {
        let layer = "GroupMaxPool";
        LayerError::check_feature_map_size(layer, shape, 0)?;
        let fields = shape.fields.num_regular_fields().ok_or(LayerError::InvalidFieldType {
            layer,
            got: shape.fields,
            expected: "regular fields only",
        })?;
        Ok(GroupMaxPool { shape, fields })
    }
}

impl LayerSignature for GroupMaxPool {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    /// Returns the shape after pooling over the group: a trivial channel for each regular field.
    fn out_shape(&self) -> Shape {
        Shape { fields: self.shape.fields.group().trivial_type(self.fields), ..self.shape }
    }
}

impl fmt::Display for GroupMaxPool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "GroupMaxPool({})", self.shape)
    }
}

impl Parameterless for GroupMaxPool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::GroupMaxPool
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let order = self.shape.fields.group().order();
        with_const_order!(G = order, forward::<T, G>(self.fields, x, y));
    }

    fn backprop<T: Scalar>(&self, x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let order = self.shape.fields.group().order();
        with_const_order!(G = order, backward::<T, G>(self.fields, x, dy, dx));
    }
}

/// Writes the maximum over the group of each of the n regular fields of every pixel.
fn forward<T: Scalar, const G: usize>(n: usize, x: &[T], y: &mut [T]) {
    for (pixel, out) in x.chunks_exact(G * n).zip(y.chunks_exact_mut(n)) {
        let pixel = split_by_irrep::<T, G>(pixel, n);
        for f in 0..n {
            out[f] = first_maximum(walsh_hadamard::<T, G>(from_fn(|a| pixel[a][f]))).1;
        }
    }
}

/// Writes the input gradient of a maximum over the group: the group element that holds a field's
/// maximum receives the field's output gradient.
fn backward<T: Scalar, const G: usize>(n: usize, x: &[T], dy: &[T], dx: &mut [T]) {
    let inputs = x.chunks_exact(G * n).zip(dy.chunks_exact(n));
    for ((pixel, upstream), gradient) in inputs.zip(dx.chunks_exact_mut(G * n)) {
        let pixel = split_by_irrep::<T, G>(pixel, n);
        let gradient = split_by_irrep_mut::<T, G>(gradient, n);
        for f in 0..n {
            let (g, _) = first_maximum(walsh_hadamard::<T, G>(from_fn(|a| pixel[a][f])));
            let mut values = [T::ZERO; G];
            values[g] = upstream[f];
            let values = walsh_hadamard(values);
            for a in 0..G {
                gradient[a][f] = values[a];
            }
        }
    }
}

/// Returns the index of the first of the largest values and the value; NaN exceeds every number.
fn first_maximum<T: Scalar, const G: usize>(values: [T; G]) -> (usize, T) {
    let mut best = (0, values[0]);
    for (g, &value) in values.iter().enumerate().skip(1) {
        if exceeds_or_is_nan(value, best.1) {
            best = (g, value);
        }
    }
    best
}

/// Returns an example of [`GroupMaxPool`] for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let pool = GroupMaxPool::new(Shape::image(2, 3, group.regular_type(4)))?;
    Ok(vec![TestLayer::exact("group max-pool", pool)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_go_to_the_first_element() {
        assert_eq!(first_maximum([1.0, 3.0, 3.0, 2.0]), (1, 3.0));
    }

    #[test]
    fn not_a_number_is_never_pooled_away() {
        for place in 0..4 {
            let mut values = [1.0f64, 5.0, 2.0, 3.0];
            values[place] = f64::NAN;
            assert!(first_maximum(values).1.is_nan(), "{values:?}");
        }
    }
}

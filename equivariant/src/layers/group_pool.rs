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

/// Shape of feature maps of regular fields, with the number of fields.
#[derive(Clone, Copy, Debug)]
struct RegularMaps {
    shape: Shape,
    fields: usize,
}

impl RegularMaps {
    /// Creates the shape after checking that its field type consists of regular fields only.
    fn new(layer: &'static str, shape: Shape) -> Result<RegularMaps, LayerError> {
        LayerError::check_map(layer, shape, 0)?;
        let fields = shape.fields.num_regular_fields().ok_or(LayerError::InvalidFieldType {
            layer,
            got: shape.fields,
            expected: "regular fields only",
        })?;
        Ok(RegularMaps { shape, fields })
    }

    /// Returns the shape after pooling over the group: a trivial channel for each regular field.
    fn pooled(&self) -> Shape {
        let fields = self.shape.fields.group().trivial_type(self.fields);
        Shape { fields, ..self.shape }
    }
}

/// Implements the parts that are common to layers that reduce each regular field to one number.
macro_rules! pooled_over_the_group {
    ($Pool:ident) => {
        impl $Pool {
            /// Creates the pooling over the group for feature maps of this shape.
            ///
            /// # Errors
            /// When the map is empty or its type is not regular fields only.
            pub fn new(shape: Shape) -> Result<$Pool, LayerError> {
                RegularMaps::new(stringify!($Pool), shape).map($Pool)
            }
        }

        impl LayerSignature for $Pool {
            fn in_shape(&self) -> Shape {
                self.0.shape
            }

            fn out_shape(&self) -> Shape {
                self.0.pooled()
            }
        }

        impl fmt::Display for $Pool {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($Pool), "({})"), self.0.shape)
            }
        }
    };
}

/// Layer that takes the maximum of every regular field over the elements of the group.
///
/// Maps n regular fields to n trivial channels: the largest value in the regular basis. On ties the
/// gradient goes to the first group element.
#[derive(Clone, Copy, Debug)]
pub struct GroupMaxPool(RegularMaps);

pooled_over_the_group!(GroupMaxPool);

impl Parameterless for GroupMaxPool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::GroupMaxPool
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let order = self.0.shape.fields.group().order();
        with_const_order!(G = order, forward::<T, G>(self.0.fields, x, y));
    }

    fn backprop<T: Scalar>(&self, x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let order = self.0.shape.fields.group().order();
        with_const_order!(G = order, backward::<T, G>(self.0.fields, x, dy, dx));
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

/// Layer that takes the mean of every regular field over the elements of the group.
///
/// Maps n regular fields to n trivial channels. The mean of a field's values is its trivial
/// coefficient over the square root of the group's order; the other coefficients do not matter, so
/// the layer is linear.
#[derive(Clone, Copy, Debug)]
pub struct GroupMeanPool(RegularMaps);

impl GroupMeanPool {
    /// Returns the factor from a field's trivial coefficient to its mean over the group, 1 /
    /// sqrt(|G|).
    fn scale<T: Scalar>(&self) -> T {
        let order = self.0.shape.fields.group().order() as f64;
        T::from_f64(order.sqrt().recip())
    }
}

pooled_over_the_group!(GroupMeanPool);

impl Parameterless for GroupMeanPool {
    fn kind<T: Scalar>(&self) -> LayerKind<'_, T> {
        LayerKind::GroupMeanPool
    }

    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let (dim, scale) = (self.0.shape.fields.dim(), self.scale::<T>());
        let ys = y.chunks_exact_mut(self.0.fields);
        for (pixel, out) in x.chunks_exact(dim).zip(ys) {
            for (pooled, &value) in out.iter_mut().zip(pixel) {
                *pooled = value * scale;
            }
        }
    }

    fn backprop<T: Scalar>(&self, _x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let (dim, scale) = (self.0.shape.fields.dim(), self.scale::<T>());
        let dys = dy.chunks_exact(self.0.fields);
        for (gradient, upstream) in dx.chunks_exact_mut(dim).zip(dys) {
            let (trivial, rest) = gradient.split_at_mut(upstream.len());
            for (entry, &value) in trivial.iter_mut().zip(upstream) {
                *entry = value * scale;
            }
            rest.fill(T::ZERO);
        }
    }
}

/// Returns examples of [`GroupMaxPool`] and [`GroupMeanPool`] for the tests that run on every kind
/// of layer.
pub(super) fn sample_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let shape = Shape::image(2, 3, group.regular_type(4));
    Ok(vec![
        TestLayer::exact("group max-pool", GroupMaxPool::new(shape)?),
        TestLayer::exact("group mean-pool", GroupMeanPool::new(shape)?),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use crate::steerable::hadamard::hadamard_transform;

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

    #[test]
    fn the_mean_is_that_of_the_regular_basis() {
        for group in Group::ALL {
            let pool = GroupMeanPool::new(Shape::vector(group.regular_type(1))).unwrap();
            let values = [1.0, -2.0, 3.0, -8.0];
            let mut x = values[..group.order()].to_vec();
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            hadamard_transform(group, &mut x);
            let mut y = [0.0];
            pool.forward(&[], &x, &mut y, &mut pool.allocate_scratch(1));
            assert!((y[0] - mean).abs() < 1e-15, "{group}");
        }
    }
}

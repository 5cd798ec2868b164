//! Group max-pooling: from regular fields to invariants.

use std::array::from_fn;

use crate::layers::parameterless::Parameterless;
use crate::layers::regular_pool::{RegularMaps, pooled_over_the_group};
use crate::layers::scalar::Scalar;
use crate::order::with_order;
use crate::real::exceeds;
use crate::steerable::hadamard::{parts, parts_mut, transform};

/// The maximum over the group of every regular field.
///
/// Maps n regular fields to n trivial channels: the largest value in the regular basis. On
/// ties the gradient goes to the first group element.
#[derive(Clone, Copy, Debug)]
pub struct GroupMaxPool(RegularMaps);

pooled_over_the_group!(GroupMaxPool);

impl Parameterless for GroupMaxPool {
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let order = self.0.shape.fields.group().order();
        with_order!(G = order, forward::<T, G>(self.0.fields, x, y));
    }

    fn pull_back<T: Scalar>(&self, x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let order = self.0.shape.fields.group().order();
        with_order!(G = order, backward::<T, G>(self.0.fields, x, dy, dx));
    }
}

fn forward<T: Scalar, const G: usize>(n: usize, x: &[T], y: &mut [T]) {
    for (x, y) in x.chunks_exact(G * n).zip(y.chunks_exact_mut(n)) {
        let x = parts::<T, G>(x, n);
        for f in 0..n {
            y[f] = first_maximum(transform::<T, G>(from_fn(|a| x[a][f]))).1;
        }
    }
}

fn backward<T: Scalar, const G: usize>(n: usize, x: &[T], dy: &[T], dx: &mut [T]) {
    let inputs = x.chunks_exact(G * n).zip(dy.chunks_exact(n));
    for ((x, dy), dx) in inputs.zip(dx.chunks_exact_mut(G * n)) {
        let x = parts::<T, G>(x, n);
        let dx = parts_mut::<T, G>(dx, n);
        for f in 0..n {
            let (g, _) = first_maximum(transform::<T, G>(from_fn(|a| x[a][f])));
            let mut values = [T::ZERO; G];
            values[g] = dy[f];
            let values = transform(values);
            for a in 0..G {
                dx[a][f] = values[a];
            }
        }
    }
}

/// The first of the largest values, and its place; not a number counts as larger than anything.
fn first_maximum<T: Scalar, const G: usize>(values: [T; G]) -> (usize, T) {
    let mut best = (0, values[0]);
    for (g, &value) in values.iter().enumerate().skip(1) {
        if exceeds(value, best.1) {
            best = (g, value);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::layers::layer::Layer;
    use crate::shape::Shape;

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
    fn the_largest_value_of_the_regular_basis_comes_out() {
        let pool = GroupMaxPool::new(Shape::vector(Group::D2.regular(1))).unwrap();
        let x: [f64; 4] = transform([1.0, -2.0, 3.0, -4.0]);
        let mut y = [0.0];
        let mut scratch = pool.scratch(1);
        pool.forward(&[], &x, &mut y, &mut scratch);
        assert_eq!(y, [3.0]);
        let mut dx = [0.0; 4];
        pool.backward(&[], &x, &y, &[2.0], Some(&mut dx), &mut [], &mut scratch);
        assert_eq!(transform(dx), [0.0, 0.0, 2.0, 0.0]);
    }

    #[test]
    fn trivial_channels_are_refused() {
        let shape = Shape::vector(Group::D2.trivial(4));
        let message = GroupMaxPool::new(shape).unwrap_err().to_string();
        assert!(
            message.contains("got the type `4 1`, expected regular"),
            "{message}"
        );
    }
}

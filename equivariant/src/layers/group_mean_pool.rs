//! Group mean-pooling: from regular fields to invariants.

use crate::layers::parameterless::Parameterless;
use crate::layers::regular_pool::{RegularMaps, pooled_over_the_group};
use crate::layers::scalar::Scalar;

/// The mean over the group of every regular field.
///
/// Maps n regular fields to n trivial channels: the mean of a field's values is its trivial
/// coefficient over the square root of the group's order. The other coefficients are dropped, so it
/// is linear.
#[derive(Clone, Copy, Debug)]
pub struct GroupMeanPool(RegularMaps);

impl GroupMeanPool {
    fn scale<T: Scalar>(&self) -> T {
        let order = self.0.shape.fields.group().order() as f64;
        T::from_f64(order.sqrt().recip())
    }
}

pooled_over_the_group!(GroupMeanPool);

impl Parameterless for GroupMeanPool {
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let (dim, scale) = (self.0.shape.fields.dim(), self.scale::<T>());
        let ys = y.chunks_exact_mut(self.0.fields);
        for (x, y) in x.chunks_exact(dim).zip(ys) {
            for (y, &x) in y.iter_mut().zip(x) {
                *y = x * scale;
            }
        }
    }

    fn pull_back<T: Scalar>(&self, _x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let (dim, scale) = (self.0.shape.fields.dim(), self.scale::<T>());
        let dys = dy.chunks_exact(self.0.fields);
        for (dx, dy) in dx.chunks_exact_mut(dim).zip(dys) {
            let (trivial, rest) = dx.split_at_mut(dy.len());
            for (dx, &dy) in trivial.iter_mut().zip(dy) {
                *dx = dy * scale;
            }
            rest.fill(T::ZERO);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use crate::shape::Shape;
    use crate::steerable::hadamard::hadamard;
    use symmetry::Group;

    #[test]
    fn the_mean_is_that_of_the_regular_basis() {
        for group in Group::ALL {
            let pool = GroupMeanPool::new(Shape::vector(group.regular(1))).unwrap();
            let values = [1.0, -2.0, 3.0, -8.0];
            let mut x = values[..group.order()].to_vec();
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            hadamard(group, &mut x);
            let mut y = [0.0];
            pool.forward(&[], &x, &mut y, &mut pool.scratch(1));
            assert!((y[0] - mean).abs() < 1e-15, "{group}");
        }
    }

    #[test]
    fn trivial_channels_of_a_larger_group_are_refused() {
        let shape = Shape::vector(Group::C2.trivial(4));
        let message = GroupMeanPool::new(shape).unwrap_err().to_string();
        assert!(message.contains("got the type `C2: 4 1`"), "{message}");
    }
}

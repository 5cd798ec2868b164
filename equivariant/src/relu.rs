//! ReLU on regular or trivial fields.

use std::fmt;

use rand::Rng;

use crate::hadamard::{hadamard4, quarters, quarters_mut};
use crate::{Layer, LayerError, Scalar, Shape};

/// The pointwise max(0, .) in the regular basis.
///
/// D2 permutes the regular basis, so a pointwise map there is equivariant: Hadamard
/// transform, ReLU, transform back, all orthonormal. On trivial channels it is the plain ReLU.
#[derive(Clone, Copy, Debug)]
pub struct Relu {
    shape: Shape,
}

impl Relu {
    /// The ReLU of maps of this shape.
    ///
    /// # Errors
    /// When the type is neither regular fields only nor trivial channels only.
    pub fn new(shape: Shape) -> Result<Relu, LayerError> {
        if shape.fields.regular_fields().is_none() && !shape.fields.is_trivial() {
            return Err(LayerError::Type {
                layer: "Relu",
                got: shape.fields,
                expected: "regular fields only or trivial channels only",
            });
        }
        Ok(Relu { shape })
    }
}

impl<T: Scalar> Layer<T> for Relu {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        self.shape
    }

    fn num_params(&self) -> usize {
        0
    }

    fn init_scaled(&self, _rng: &mut dyn Rng, _gain: f64, _params: &mut [T]) {}

    fn scratch_len(&self, _samples: usize) -> usize {
        0
    }

    fn forward(&self, _params: &[T], x: &[T], y: &mut [T], _scratch: &mut [T]) {
        assert_eq!(x.len(), y.len(), "input and output differ in length");
        match self.shape.fields.regular_fields() {
            // constant widths let the compiler vectorise the common cases
            Some(4) => forward_regular(4, x, y),
            Some(8) => forward_regular(8, x, y),
            Some(16) => forward_regular(16, x, y),
            Some(n) => forward_regular(n, x, y),
            None => forward_trivial(x, y),
        }
    }

    fn backward(
        &self,
        _params: &[T],
        x: &[T],
        _y: &[T],
        dy: &[T],
        dx: Option<&mut [T]>,
        _dparams: &mut [T],
        _scratch: &mut [T],
    ) {
        let Some(dx) = dx else { return };
        assert_eq!(x.len(), dy.len(), "input and gradient differ in length");
        assert_eq!(x.len(), dx.len(), "input and its gradient differ in length");
        match self.shape.fields.regular_fields() {
            Some(4) => backward_regular(4, x, dy, dx),
            Some(8) => backward_regular(8, x, dy, dx),
            Some(16) => backward_regular(16, x, dy, dx),
            Some(n) => backward_regular(n, x, dy, dx),
            None => backward_trivial(x, dy, dx),
        }
    }
}

/// Zero where `gate` is at most zero, else `value`: not a number stays visible.
#[inline(always)]
fn pass<T: Scalar>(gate: T, value: T) -> T {
    if gate <= T::ZERO { T::ZERO } else { value }
}

fn forward_trivial<T: Scalar>(x: &[T], y: &mut [T]) {
    for (y, &x) in y.iter_mut().zip(x) {
        *y = pass(x, x);
    }
}

fn backward_trivial<T: Scalar>(x: &[T], dy: &[T], dx: &mut [T]) {
    for ((dx, &dy), &x) in dx.iter_mut().zip(dy).zip(x) {
        *dx = pass(x, dy);
    }
}

#[inline(always)]
fn forward_regular<T: Scalar>(n: usize, x: &[T], y: &mut [T]) {
    let width = (4 * n).max(1);
    for (x, y) in x.chunks_exact(width).zip(y.chunks_exact_mut(width)) {
        let [a, b, c, d] = quarters(x, n);
        let [ya, yb, yc, yd] = quarters_mut(y, n);
        for f in 0..n {
            let values = hadamard4([a[f], b[f], c[f], d[f]]).map(|v| pass(v, v));
            [ya[f], yb[f], yc[f], yd[f]] = hadamard4(values);
        }
    }
}

#[inline(always)]
fn backward_regular<T: Scalar>(n: usize, x: &[T], dy: &[T], dx: &mut [T]) {
    let width = (4 * n).max(1);
    let inputs = x.chunks_exact(width).zip(dy.chunks_exact(width));
    for ((x, dy), dx) in inputs.zip(dx.chunks_exact_mut(width)) {
        let [a, b, c, d] = quarters(x, n);
        let [ea, eb, ec, ed] = quarters(dy, n);
        let [da, db, dc, dd] = quarters_mut(dx, n);
        for f in 0..n {
            let gates = hadamard4([a[f], b[f], c[f], d[f]]);
            let mut values = hadamard4([ea[f], eb[f], ec[f], ed[f]]);
            for (value, gate) in values.iter_mut().zip(gates) {
                *value = pass(gate, *value);
            }
            [da[f], db[f], dc[f], dd[f]] = hadamard4(values);
        }
    }
}

impl fmt::Display for Relu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Relu({})", self.shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use symmetry::FieldType;

    #[test]
    fn one_field_is_rectified_in_the_regular_basis() {
        let relu = Relu::new(Shape::vector(FieldType::regular(1))).unwrap();
        let x: [f64; 4] = hadamard4([1.0, -2.0, 3.0, -4.0]);
        let mut y = [0.0; 4];
        relu.forward(&[], &x, &mut y, &mut []);
        assert_eq!(hadamard4(y), [1.0, 0.0, 3.0, 0.0]);
    }

    #[test]
    fn trivial_channels_are_rectified_as_they_are() {
        let relu = Relu::new(Shape::vector(FieldType::trivial(3))).unwrap();
        let mut y = [0.0; 3];
        relu.forward(&[], &[-1.0, 0.0, 2.0], &mut y, &mut []);
        assert_eq!(y, [0.0, 0.0, 2.0]);
    }

    #[test]
    fn not_a_number_stays_visible() {
        let relu = Relu::new(Shape::vector(FieldType::trivial(2))).unwrap();
        let mut y = [0.0f64; 2];
        relu.forward(&[], &[f64::NAN, -1.0], &mut y, &mut []);
        assert!(y[0].is_nan() && y[1] == 0.0);
    }

    #[test]
    fn odd_irreps_alone_are_refused() {
        let shape = Shape::vector(FieldType::new([2, 1, 1, 0]));
        let message = Relu::new(shape).unwrap_err().to_string();
        assert!(
            message.contains("got the type `2 1 + 1 x + 1 y`"),
            "{message}"
        );
    }
}

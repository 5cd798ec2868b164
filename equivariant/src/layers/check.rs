//! The equivariance checker.

use rand::Rng;

use crate::init::fill_normal;
use crate::layers::layer::Layer;
use crate::layers::scalar::Scalar;
use crate::shape::Shape;

/// The largest relative error of f(g x) = g f(x) over the elements of the group.
///
/// Draws `trials` inputs of one sample each with normal entries; `f(x, y)` writes the output `y` of
/// a sample `x`. The group of the input's type acts on pixels and channels as the two shapes say.
/// The error of a trial is the largest absolute difference over the largest absolute output; an
/// output that is not finite gives infinity.
///
/// # Panics
/// When the types of the two shapes belong to different groups, or there are no trials.
pub fn equivariance_error_of<T: Scalar>(
    in_shape: Shape,
    out_shape: Shape,
    mut f: impl FnMut(&[T], &mut [T]),
    trials: usize,
    rng: &mut dyn Rng,
) -> f64 {
    let (group, out_group) = (in_shape.fields.group(), out_shape.fields.group());
    assert_eq!(
        group, out_group,
        "input and output belong to different groups"
    );
    assert!(trials > 0, "got 0 trials, expected at least 1");
    let mut worst: f64 = 0.0;
    // what f leaves unwritten is not finite
    let mut f = |x: &[T], y: &mut [T]| {
        y.fill(T::from_f64(f64::NAN));
        f(x, y);
    };
    let mut x = vec![T::ZERO; in_shape.len()];
    let mut y = vec![T::ZERO; out_shape.len()];
    let mut y_of_gx = y.clone();
    for _ in 0..trials {
        fill_normal(rng, 1.0, &mut x);
        f(&x, &mut y);
        for &g in group.elements() {
            f(&in_shape.act(g, &x), &mut y_of_gx);
            worst = worst.max(relative_error(&y_of_gx, &out_shape.act(g, &y)));
        }
    }
    worst
}

/// The [`equivariance_error_of`] of a layer.
pub fn equivariance_error<T: Scalar>(
    layer: &dyn Layer<T>,
    params: &[T],
    trials: usize,
    rng: &mut dyn Rng,
) -> f64 {
    let mut scratch = layer.scratch(1);
    let f = |x: &[T], y: &mut [T]| layer.forward(params, x, y, &mut scratch);
    equivariance_error_of(layer.in_shape(), layer.out_shape(), f, trials, rng)
}

fn relative_error<T: Scalar>(got: &[T], expected: &[T]) -> f64 {
    let mut scale = f64::MIN_POSITIVE;
    let mut error: f64 = 0.0;
    for (&g, &e) in got.iter().zip(expected) {
        let difference = (g.to_f64() - e.to_f64()).abs();
        if !difference.is_finite() {
            return f64::INFINITY;
        }
        error = error.max(difference);
        scale = scale.max(e.to_f64().abs());
    }
    error / scale
}

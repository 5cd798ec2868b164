//! Backward passes against central differences, in double precision.

use equivariant::Layer;

use crate::common::{
    forward, largest, largest_deviation, largest_magnitude, layers, normal, params, run, scratch,
    unwritten,
};

const SAMPLES: usize = 3;
const STEP: f64 = 1e-5;
const TOLERANCE: f64 = 1e-7;

/// Layer with parameters, an input, and the gradient of its output.
struct Case {
    name: String,
    layer: Box<dyn Layer<f64>>,
    params: Vec<f64>,
    x: Vec<f64>,
    dy: Vec<f64>,
}

fn cases() -> impl Iterator<Item = Case> {
    layers::<f64>().into_iter().map(|(name, layer)| Case {
        name,
        params: params(layer.as_ref(), 1),
        x: normal(SAMPLES * layer.in_shape().len(), 2),
        dy: normal(SAMPLES * layer.out_shape().len(), 3),
        layer,
    })
}

fn difference(at: &[f64], i: usize, f: impl Fn(&[f64]) -> f64) -> f64 {
    let moved = |by: f64| {
        let mut moved = at.to_vec();
        moved[i] += by;
        f(&moved)
    };
    (moved(STEP) - moved(-STEP)) / (2.0 * STEP)
}

/// Returns the largest error of analytic gradients, relative to the largest of them.
fn error(analytic: &[f64], at: &[f64], f: impl Fn(&[f64]) -> f64) -> f64 {
    // NaN stays NaN, which is not below 1e-3
    let scale = largest([1e-3, largest_magnitude(analytic)].into_iter());
    // a spread of entries suffices, because a wrong formula is wrong nearly everywhere
    let stride = (at.len() / 120).max(1);
    let entries = (0..at.len()).step_by(stride);
    largest(entries.map(|i| (difference(at, i, &f) - analytic[i]).abs() / scale))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn backward_is_the_derivative_of_forward() {
    for Case { name, layer, params, x, dy } in cases() {
        let layer = layer.as_ref();
        let [_, dx, dparams] = run(layer, &params, &x, &dy);
        let in_x = error(&dx, &x, |x| dot(&dy, &forward(layer, &params, x)));
        assert!(in_x < TOLERANCE, "{name}: error {in_x} in the input");
        let in_params = error(&dparams, &params, |params| dot(&dy, &forward(layer, params, &x)));
        assert!(in_params < TOLERANCE, "{name}: error {in_params} in the parameters");
    }
}

#[test]
fn the_comparison_sees_a_wrong_gradient() {
    let x = [1.0, 2.0];
    let square = |at: &[f64]| at[0] * at[0] + at[1];
    assert!(error(&[2.0, 1.0], &x, square) < TOLERANCE);
    assert!(error(&[2.0, 1.01], &x, square) > 1e-3);
    for poisoned in [[f64::NAN, 1.0], [2.0, f64::NAN]] {
        assert!(error(&poisoned, &x, square).is_nan());
    }
    assert!(error(&[2.0, 1.0], &x, |x| square(x) + f64::NAN).is_nan());
}

#[test]
fn parameter_gradients_do_not_need_the_input_gradient() {
    for case in cases() {
        let [params, x, dy] = [&case.params[..], &case.x, &case.dy];
        let layer = case.layer.as_ref();
        let [_, _, expected] = run(layer, params, x, dy);
        let mut scratch = scratch(layer, SAMPLES);
        let mut y = unwritten(dy.len());
        layer.forward(params, x, &mut y, &mut scratch);
        let mut dparams = vec![1.0; params.len()];
        layer.backward(params, x, &y, dy, None, &mut dparams, &mut scratch);
        dparams.iter_mut().for_each(|d| *d -= 1.0);
        // sums may be in another order
        let error = largest_deviation(&dparams, &expected);
        let scale = largest_magnitude(&expected).max(1.0);
        assert!(error < 1e-13 * scale, "{}: {error}", case.name);
    }
}

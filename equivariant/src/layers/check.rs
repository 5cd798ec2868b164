//! Diagnostics of networks: the equivariance error, and the outputs of single units.

use rand::Rng;

use crate::layers::layer::{Layer, LayerKind, Scalar};
use crate::real::fill_normal;
use crate::shape::Shape;
use crate::steerable::hadamard::{hadamard_transform_pixels, permuted_field_order_and_count};

/// Named example of a layer, for tests that run on every kind of layer.
pub struct TestLayer<T> {
    /// Name of the test layer, unique among those of one symmetry group.
    pub name: &'static str,
    /// `true` for a layer without parameters that only permutes, compares, scales and adds single
    /// values: its equivariance error is zero in any precision.
    pub is_exactly_equivariant: bool,
    /// Layer that the tests run on.
    pub layer: Box<dyn Layer<T>>,
}

impl<T: Scalar> TestLayer<T> {
    /// Creates a test layer whose equivariance error is zero.
    pub(crate) fn exact(name: &'static str, layer: impl Layer<T> + 'static) -> TestLayer<T> {
        TestLayer { name, is_exactly_equivariant: true, layer: Box::new(layer) }
    }

    /// Creates a test layer whose equivariance error is at the level of rounding.
    pub(crate) fn approximate(name: &'static str, layer: impl Layer<T> + 'static) -> TestLayer<T> {
        TestLayer { is_exactly_equivariant: false, ..TestLayer::exact(name, layer) }
    }
}

/// Returns the largest relative error of f(g x) = g f(x) over random inputs x and the elements g of
/// the output's group.
///
/// Samples `trials` inputs of one sample each with normal entries; `f(x, y)` writes the output `y`
/// of a sample `x`. The group of the output's type acts on pixels and channels according to the two
/// shapes. The error of a trial is the largest absolute difference over the largest absolute
/// output; an output that is not finite gives infinity.
///
/// # Panics
/// When the output's group is no subgroup of the input's, or `trials` is 0.
pub fn equivariance_error_of_fn<T: Scalar>(
    in_shape: Shape,
    out_shape: Shape,
    mut f: impl FnMut(&[T], &mut [T]),
    trials: usize,
    rng: &mut dyn Rng,
) -> f64 {
    let (in_group, group) = (in_shape.fields.group(), out_shape.fields.group());
    assert!(
        group.is_subgroup_of(in_group),
        "got an output of {group}, expected one of {in_group} or of a subgroup"
    );
    assert!(trials > 0, "got 0 trials, expected at least 1");
    let mut worst: f64 = 0.0;
    // entries that f does not write stay NaN, which counts as an infinite error
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
            f(&in_shape.transform_sample(g, &x), &mut y_of_gx);
            worst = worst.max(relative_error(&y_of_gx, &out_shape.transform_sample(g, &y)));
        }
    }
    worst
}

/// Returns the largest relative error of f(g x) = g f(x) for a layer f, as
/// [`equivariance_error_of_fn`] does for a function.
pub fn equivariance_error<T: Scalar>(
    layer: &dyn Layer<T>,
    params: &[T],
    trials: usize,
    rng: &mut dyn Rng,
) -> f64 {
    let mut scratch = layer.allocate_scratch(1);
    let f = |x: &[T], y: &mut [T]| layer.forward(params, x, y, &mut scratch);
    equivariance_error_of_fn(layer.in_shape(), layer.out_shape(), f, trials, rng)
}

/// Returns the largest absolute difference over the largest absolute expected value; infinity if a
/// difference is not finite.
fn relative_error<T: Scalar>(got: &[T], expected: &[T]) -> f64 {
    // not 0, so that outputs of zeros give an error of 0 instead of NaN
    let mut scale = f64::MIN_POSITIVE;
    let mut error: f64 = 0.0;
    for (&g, &e) in got.iter().zip(expected) {
        let difference = (g.to_f64() - e.to_f64()).abs();
        // `max` would ignore NaN
        if !difference.is_finite() {
            return f64::INFINITY;
        }
        error = error.max(difference);
        scale = scale.max(e.to_f64().abs());
    }
    error / scale
}

/// Sums the absolute outputs of every ReLU unit over all samples and pixels of the input `x`,
/// `[N, H, W, C]`.
///
/// Returns a list for each ReLU of a chain, in order, except for those inside a
/// [`BranchSum`](crate::BranchSum). A unit is a channel of a ReLU in the basis in which it is
/// pointwise: |G| of them for a regular field. The layers of the chain run one by one, so nothing
/// is fused and every map is allocated: the function is meant for occasional diagnostics.
///
/// # Panics
/// When a slice has a length other than the layer's shapes imply.
pub fn absolute_activation_sums<T: Scalar>(
    layer: &dyn Layer<T>,
    params: &[T],
    x: &[T],
) -> Vec<Vec<f64>> {
    let mut sums = Vec::new();
    run_and_sum(layer, params, x, &mut sums);
    sums
}

/// Returns the output of a layer, or of a chain run layer by layer, and appends the sums of
/// absolute outputs of each ReLU to `sums`.
fn run_and_sum<T: Scalar>(
    layer: &dyn Layer<T>,
    params: &[T],
    x: &[T],
    sums: &mut Vec<Vec<f64>>,
) -> Vec<T> {
    let LayerKind::Sequential(layers) = layer.kind() else {
        let y = run_layer(layer, params, x);
        if matches!(layer.kind(), LayerKind::Relu) {
            sums.push(channel_sums(layer, y.clone()));
        }
        return y;
    };
    let mut rest = params;
    layers.iter().fold(x.to_vec(), |x, child| {
        let (own, others) = rest.split_at(child.num_params());
        rest = others;
        run_and_sum(child.as_ref(), own, &x, sums)
    })
}

fn run_layer<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T]) -> Vec<T> {
    let samples = x.len() / layer.in_shape().len();
    let mut y = vec![T::ZERO; samples * layer.out_shape().len()];
    layer.forward(params, x, &mut y, &mut layer.allocate_scratch(samples));
    y
}

/// Returns the sum of the absolute values of each channel of feature maps, in the basis that the
/// group permutes.
fn channel_sums<T: Scalar>(layer: &dyn Layer<T>, mut maps: Vec<T>) -> Vec<f64> {
    let fields = layer.out_shape().fields;
    if let Some((order, n)) = permuted_field_order_and_count(fields) {
        hadamard_transform_pixels(order, n, &mut maps);
    }
    let mut sums = vec![0.0; fields.dim()];
    for pixel in maps.chunks_exact(fields.dim()) {
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += value.to_f64().abs();
        }
    }
    sums
}

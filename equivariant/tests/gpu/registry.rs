//! Every layer on the device against the CPU's.

use equivariant::gpu::{GpuError, GpuLayer};
use equivariant::{
    Group, Layer, LayerKind, Relu, Sequential, equivariance_error, equivariance_error_of_fn,
};

use crate::common::{
    boxed, conv, largest, largest_deviation, largest_magnitude, normal, params, rng, run,
};
use crate::device;

const SAMPLES: usize = 3;
/// Tolerance relative to the CPU's largest value.
const TOLERANCE: f64 = 1e-4;

type Named = (String, Box<dyn Layer<f32>>);

/// Returns `true` for a layer without device kernels.
fn refused((_, layer): &Named) -> bool {
    matches!(layer.kind(), LayerKind::Other)
}

/// Returns the layers that run on a device.
fn layers() -> impl Iterator<Item = Named> {
    let all = crate::common::layers().into_iter();
    all.filter(|layer| !refused(layer))
}

#[test]
fn layers_without_kernels_are_refused_by_name() {
    let all = crate::common::layers().into_iter();
    let others: Vec<Named> = all.filter(refused).collect();
    assert!(!others.is_empty());
    for (_, layer) in others {
        // a layer that loses its kind would drop out of all comparisons
        let name = layer.to_string();
        let expected = name.starts_with("Sum(") || name.starts_with("Restrict(");
        assert!(expected, "{name}");
        let error = GpuLayer::new(device(), layer.as_ref(), 1).unwrap_err();
        let layer = layer.to_string();
        assert_eq!(error, GpuError::UnsupportedLayer { layer });
    }
}

fn network(layer: &dyn Layer<f32>, params: &[f32]) -> GpuLayer {
    let mut network = GpuLayer::new(device(), layer, 5).unwrap();
    network.set_params(params);
    network
}

fn deviation(got: &[f32], expected: &[f32]) -> f64 {
    // biases that a linear layer's type lacks have no gradient at all
    let scale = largest([1e-3, largest_magnitude(expected)].into_iter());
    largest_deviation(got, expected) / scale
}

#[test]
fn outputs_and_gradients_are_those_of_the_cpu() {
    for (name, layer) in layers() {
        assert_alike(&name, layer.as_ref());
    }
}

/// Compares outputs and gradients with the CPU's.
fn assert_alike(name: &str, layer: &dyn Layer<f32>) {
    let params = params(layer, 1);
    let x = normal(SAMPLES * layer.in_shape().len(), 2);
    let dy = normal(SAMPLES * layer.out_shape().len(), 3);
    let [y, dx, dparams] = run(layer, &params, &x, &dy);
    let mut network = network(layer, &params);
    let output = network.forward(&x).unwrap();
    let error = deviation(&output, &y);
    assert!(error < TOLERANCE, "{name}: error {error} in the output");
    let gradients = network.backward(&dy).unwrap();
    let input_error = deviation(&gradients.input, &dx);
    assert!(input_error < TOLERANCE, "{name}: error {input_error} in the input");
    let param_error = deviation(&gradients.params, &dparams);
    assert!(param_error < TOLERANCE, "{name}: error {param_error} in the parameters");
}

/// Returns the equivariance error of a device's results with these parameters.
fn equivariance_error_on(layer: &dyn Layer<f32>, params: &[f32]) -> f64 {
    let mut network = network(layer, params);
    let run = |x: &[f32], y: &mut [f32]| y.copy_from_slice(&network.forward(x).unwrap());
    equivariance_error_of_fn(layer.in_shape(), layer.out_shape(), run, 3, &mut rng(5))
}

#[test]
fn all_layers_are_as_equivariant_as_on_the_cpu() {
    for (name, layer) in layers() {
        let layer = layer.as_ref();
        let params = params(layer, 1);
        let here = equivariance_error(layer, &params, 3, &mut rng(5));
        let there = equivariance_error_on(layer, &params);
        // layers that are exact on the CPU are exact here
        let allowed = if here == 0.0 { 0.0 } else { 1e-5 };
        assert!(there <= allowed, "{name}: error {there}, and {here} on the CPU");
    }
}

/// Checks a first layer and a later one, each with a ReLU, on even and odd windows.
#[test]
fn convolutions_are_exactly_equivariant() {
    for group in Group::ALL {
        for (window, size) in [([4, 2, 1], 8), ([3, 2, 1], 7)] {
            let regular = group.regular_type(3);
            let first = conv(group.trivial_type(3), regular, window, [size; 2]);
            let relu = boxed(Relu::new(first.out_shape()));
            let side = first.out_shape().height;
            let second = conv(regular, regular, [3, 1, 1], [side; 2]);
            let net = Sequential::new(vec![first, relu, second]).unwrap();
            let error = equivariance_error_on(&net, &params(&net, 1));
            assert_eq!(error, 0.0, "{window:?} of {group}");
        }
    }
}

#[test]
fn a_relu_after_weights_takes_no_kernel_of_its_own() {
    let first = conv(Group::D2.trivial_type(3), Group::D2.regular_type(2), [4, 2, 1], [8, 8]);
    let relu = boxed(Relu::new(first.out_shape()));
    let alone = GpuLayer::new(device(), relu.as_ref(), 1).unwrap();
    assert_eq!(alone.num_kernels_per_pass(), [1, 1]);
    let net = Sequential::new(vec![first, relu]).unwrap();
    // fold and product; the gradient of the weights and its sum; that of the patches and the unfold
    let fused = GpuLayer::new(device(), &net, 1).unwrap();
    assert_eq!(fused.num_kernels_per_pass(), [2, 4]);
}

#[test]
fn a_wrong_parameter_and_a_wrong_gradient_are_seen() {
    let layer: Box<dyn Layer<f32>> =
        conv(Group::D2.regular_type(2), Group::D2.regular_type(3), [3, 1, 1], [4, 4]);
    let params = params(layer.as_ref(), 1);
    let x = normal(layer.in_shape().len(), 2);
    let dy = normal(layer.out_shape().len(), 3);
    let [y, _, dparams] = run(layer.as_ref(), &params, &x, &dy);
    for i in 0..params.len() {
        let mut wrong = params.clone();
        wrong[i] += 0.01;
        let mut network = network(layer.as_ref(), &wrong);
        let output = network.forward(&x).unwrap();
        assert!(deviation(&output, &y) > TOLERANCE, "parameter {i}");
        let mut gradient = network.backward(&dy).unwrap().params;
        assert!(deviation(&gradient, &dparams) < TOLERANCE);
        gradient[i] += 0.01 * largest_magnitude(&dparams) as f32;
        assert!(deviation(&gradient, &dparams) > TOLERANCE);
    }
}

#[test]
fn the_same_bits_come_twice_whatever_came_before() {
    for (name, layer) in layers().filter(|(name, _)| name.ends_with(" of D2")) {
        let layer = layer.as_ref();
        let params = params(layer, 1);
        let x = normal(3 * layer.in_shape().len(), 2);
        let dy = normal(3 * layer.out_shape().len(), 3);
        let results = |earlier: u64| {
            let mut network = network(layer, &params);
            let x_before = normal::<f32>(5 * layer.in_shape().len(), earlier);
            let dy_before = normal::<f32>(5 * layer.out_shape().len(), earlier);
            network.forward(&x_before).unwrap();
            network.backward(&dy_before).unwrap();
            (network.forward(&x).unwrap(), network.backward(&dy).unwrap())
        };
        assert!(results(4) == results(5), "{name}");
    }
}

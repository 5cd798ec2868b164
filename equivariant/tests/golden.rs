//! Values and gradients from PyTorch (`benches/peers/golden_layers.py`), and filters that escnn
//! expanded (`benches/peers/escnn_filters.py`).

use equivariant::{
    BranchSum, Group, GroupMaxPool, Layer, MaxPool, R2Conv, Relu, Restrict, Sequential, Shape,
    SlidingWindow, hadamard_transform,
};
use safetensors::SafeTensors;

use crate::common::{self, largest_deviation, run};

const LAYERS: &[u8] = include_bytes!("golden/layers.safetensors");
const ESCNN: &[u8] = include_bytes!("golden/escnn.safetensors");
const SIZE: [usize; 2] = [5, 7];
const TOLERANCE: f64 = 1e-12;

fn golden(name: &str) -> Vec<f64> {
    common::golden(LAYERS, name)
}

/// Transforms maps of a type between the regular basis of the file and the irrep basis of the
/// layers.
fn change(shape: Shape, mut values: Vec<f64>) -> Vec<f64> {
    if shape.fields.num_regular_fields().is_some() {
        let pixels = values.chunks_exact_mut(shape.fields.dim());
        pixels.for_each(|pixel| hadamard_transform(shape.fields.group(), pixel));
    }
    values
}

fn assert_close(name: &str, got: &[f64], expected: &[f64]) {
    let error = largest_deviation(got, expected);
    assert!(error < TOLERANCE, "{name}: {error}");
}

fn check(case: &str, layer: &dyn Layer<f64>, params: &[f64]) -> Vec<f64> {
    let (in_shape, out_shape) = (layer.in_shape(), layer.out_shape());
    let of = |part: &str| golden(&format!("{case}.{part}"));
    let (x, dy) = (change(in_shape, of("x")), change(out_shape, of("dy")));
    let [y, dx, dparams] = run(layer, params, &x, &dy);
    assert_close(case, &change(out_shape, y), &of("y"));
    assert_close(case, &change(in_shape, dx), &of("dx"));
    dparams
}

/// Returns the shape of the file's maps of 8 channels as regular fields.
fn input(group: Group) -> Shape {
    Shape::image(SIZE[0], SIZE[1], group.regular_type(8 / group.order()))
}

const WINDOW: SlidingWindow = SlidingWindow::new(3, 2, 1);

#[test]
fn layers_of_the_regular_basis_are_those_of_pytorch_for_every_group() {
    for group in Group::ALL {
        let shape = input(group);
        check("relu", &Relu::new(shape).unwrap(), &[]);
        check("max_pool", &MaxPool::new(shape, WINDOW).unwrap(), &[]);
    }
}

#[test]
fn the_group_maximum_is_that_of_its_definition_in_pytorch() {
    check("d2_group_max", &GroupMaxPool::new(input(Group::D2)).unwrap(), &[]);
}

#[test]
fn restrictions_are_those_of_their_definition_in_pytorch() {
    let shape = input(Group::D2);
    let cases = [("d1x", Group::D1x), ("d1y", Group::D1y), ("c2", Group::C2)];
    for (name, group) in cases {
        let layer = Restrict::new(shape, group).unwrap();
        check(&format!("d2_to_{name}"), &layer, &[]);
    }
}

fn params(case: &str, layer: &R2Conv) -> Vec<f64> {
    let dense = layer.as_ordinary_conv();
    let projection = dense.project_regular_basis_kernel(&golden(&format!("{case}.kernel")));
    assert!(projection.lost_share < 1e-15, "{case}: not steerable");
    let mut params = projection.params;
    let fields = dense.out_shape().fields;
    let bias = change(Shape::vector(fields), golden(&format!("{case}.bias")));
    let biases = fields.multiplicity(symmetry::Irrep::Trivial);
    let weights = params.len() - biases;
    params[weights..].copy_from_slice(&bias[..biases]);
    params
}

/// Compares the gradient of a kernel, whose steerable part is that of the parameters.
fn check_gradient(case: &str, layer: &R2Conv, gradient: &[f64]) {
    let dense = layer.as_ordinary_conv();
    let biases = dense.out_shape().fields.multiplicity(symmetry::Irrep::Trivial);
    let weights = ..gradient.len() - biases;
    let dkernel = dense.project_regular_basis_kernel(&golden(&format!("{case}.dkernel")));
    assert_close(case, &gradient[weights], &dkernel.params[weights]);
}

#[test]
fn convolutions_are_those_of_pytorch() {
    for (case, group) in [("conv", Group::C1), ("d2_conv", Group::D2)] {
        let fields = |channels: usize| group.regular_type(channels / group.order());
        let layer = R2Conv::new(fields(8), fields(4), WINDOW, SIZE).unwrap();
        let gradient = check(case, &layer, &params(case, &layer));
        check_gradient(case, &layer, &gradient);
    }
}

#[test]
fn residual_connections_are_those_of_pytorch() {
    for (case, group) in [("residual", Group::C1), ("d2_residual", Group::D2)] {
        let shape = input(group);
        let conv =
            R2Conv::new(shape.fields, shape.fields, SlidingWindow::new(3, 1, 1), SIZE).unwrap();
        let relu = Box::new(Relu::new(shape).unwrap());
        let branch = Sequential::new(vec![Box::new(conv.clone()), relu]).unwrap();
        let sum = BranchSum::residual(Box::new(branch)).unwrap();
        let gradient = check(case, &sum, &params(case, &conv));
        check_gradient(case, &conv, &gradient);
    }
}

/// Returns the share of an escnn filter that is not steerable here, after a permutation of the
/// output's elements.
fn escnn_residual(name: &str, layer: &R2Conv, elements: [usize; 4]) -> f64 {
    let tensors = SafeTensors::deserialize(ESCNN).unwrap();
    let tensor = tensors.tensor(name).unwrap();
    let dense = layer.as_ordinary_conv();
    assert_eq!(tensor.shape(), dense.kernel_shape());
    let (values, _) = tensor.data().as_chunks();
    let values: Vec<f32> = values.iter().map(|&b| f32::from_le_bytes(b)).collect();
    let blocks: Vec<&[f32]> = values.chunks(values.len() / 4).collect();
    let kernel: Vec<f32> = elements.into_iter().flat_map(|g| blocks[g].to_vec()).collect();
    dense.project_regular_basis_kernel(&kernel).lost_share
}

#[test]
fn filters_of_escnn_lie_in_the_space_of_steerable_kernels() {
    let regular = |n| Group::D2.regular_type(n);
    let cases = [
        ("lift", Group::D2.trivial_type(3), regular(2), 5),
        ("hidden", regular(2), regular(3), 5),
        ("even", regular(2), regular(2), 4),
    ];
    for (name, in_type, out_type, size) in cases {
        let layer =
            R2Conv::new(in_type, out_type, SlidingWindow::new(size, 1, 0), [size; 2]).unwrap();
        let residual = escnn_residual(name, &layer, [0, 1, 2, 3]);
        assert!(residual < 1e-6, "{name}: {residual}");
        // escnn orders the elements differently: the half turn is second
        let wrong = escnn_residual(name, &layer, [0, 3, 1, 2]);
        assert!(wrong > 0.1, "{name}: {wrong}");
    }
}

#[test]
#[should_panic(expected = "d2_to_d1x: ")]
fn a_comparison_with_other_settings_fails() {
    check("d2_to_d1x", &Restrict::new(input(Group::D2), Group::D1y).unwrap(), &[]);
}

//! Steerable kernels: the parameters are coordinates of all of them.

use equivariant::{FieldType, Group, Layer, Linear, OrdinaryConv, R2Conv, SlidingWindow};
use proptest::prelude::*;
use symmetry::D2;

use crate::common::{self, normal};

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the kernels of the unit vectors among the weights.
fn basis(dense: &OrdinaryConv, weights: usize, regular: bool) -> Vec<Vec<f64>> {
    let biases = dense.out_shape().fields.multiplicity(symmetry::Irrep::Trivial);
    let kernel = |i| {
        let mut unit = vec![0.0; weights + biases];
        unit[i] = 1.0;
        if regular { dense.regular_basis_kernel(&unit) } else { dense.kernel(&unit) }
    };
    (0..weights).map(kernel).collect()
}

fn num_weights(layer: &dyn Layer<f64>) -> usize {
    layer.num_params() - layer.out_shape().fields.multiplicity(symmetry::Irrep::Trivial)
}

/// Returns the dimension of the space of steerable kernels by characters: the mean over the group
/// of the traces of its actions on the taps, on the inputs and on the outputs.
fn dimension(in_type: FieldType, out_type: FieldType, size: usize) -> usize {
    let group = in_type.group();
    let trace = |fields: FieldType, g: D2| -> i32 {
        fields.channel_irreps().map(|irrep| i32::from(irrep.sign(g))).sum()
    };
    let fixed_taps = |g: D2| {
        let taps = (0..size * size).map(|i| (i / size, i % size));
        taps.filter(|&(row, col)| g.apply_pixel(row, col, size, size) == (row, col)).count() as i32
    };
    let traces =
        group.elements().iter().map(|&g| fixed_taps(g) * trace(in_type, g) * trace(out_type, g));
    traces.sum::<i32>() as usize / group.order()
}

/// Returns `true` if a kernel between irreps has the signs of both types at all moved taps.
fn is_steerable(dense: &OrdinaryConv, kernel: &[f64]) -> bool {
    let [_, in_dim, size, _] = dense.kernel_shape();
    let [inputs, outputs] = [dense.in_shape(), dense.out_shape()]
        .map(|shape| shape.fields.channel_irreps().collect::<Vec<_>>());
    let at =
        |out, channel, (row, col)| kernel[((out * in_dim + channel) * size + row) * size + col];
    (0..kernel.len()).all(|i| {
        let (row, col) = (i / size % size, i % size);
        let (out, channel) = (i / (size * size * in_dim), i / (size * size) % in_dim);
        dense.in_shape().fields.group().elements().iter().all(|&g| {
            let sign = f64::from(outputs[out].sign(g) * inputs[channel].sign(g));
            at(out, channel, g.apply_pixel(row, col, size, size)) == sign * kernel[i]
        })
    })
}

/// Checks that the kernels are steerable, orthonormal, and as many as the dimension of their space.
fn assert_basis(dense: &OrdinaryConv, weights: usize, regular: bool) {
    let [in_type, out_type] = [dense.in_shape(), dense.out_shape()].map(|shape| shape.fields);
    assert_eq!(weights, dimension(in_type, out_type, dense.kernel_shape()[2]));
    let basis = basis(dense, weights, regular);
    for (i, a) in basis.iter().enumerate() {
        assert!(regular || is_steerable(dense, a), "kernel {i}");
        for (j, b) in basis[..=i].iter().enumerate() {
            let expected = f64::from(u8::from(i == j));
            assert!((dot(a, b) - expected).abs() < 1e-14, "kernels {i} and {j}");
        }
    }
}

fn layer(in_type: FieldType, out_type: FieldType, size: usize) -> R2Conv {
    R2Conv::new(in_type, out_type, SlidingWindow::new(size, 1, 0), [size; 2]).unwrap()
}

fn multiplicities() -> impl Strategy<Value = [usize; 4]> {
    proptest::array::uniform4(0usize..3)
        .prop_filter("few channels", |m| (1..4).contains(&m.iter().sum::<usize>()))
}

/// Returns pairs of types of one group.
fn types() -> impl Strategy<Value = [FieldType; 2]> {
    let group = proptest::sample::select(&Group::ALL);
    let of_group = |(chosen, types): (_, [_; 2])| types.map(|of| FieldType::new(chosen, of));
    (group, [multiplicities(), multiplicities()]).prop_map(of_group)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_parameters_span_all_steerable_kernels(
        [in_type, out_type] in types(),
        size in 1usize..5,
    ) {
        let conv = layer(in_type, out_type, size);
        assert_basis(&conv.as_ordinary_conv(), num_weights(&conv), false);
    }
}

#[test]
fn regular_kernels_and_linear_layers_have_a_basis_too() {
    for group in Group::ALL {
        for size in [2, 3] {
            let conv = layer(group.regular_type(1), group.regular_type(1), size);
            assert_basis(&conv.as_ordinary_conv(), num_weights(&conv), true);
        }
        let (in_type, out_type) = (group.regular_type(2), FieldType::new(group, [2, 1, 0, 1]));
        let linear = Linear::new(in_type, out_type).unwrap();
        assert_basis(&linear.as_ordinary_conv(), num_weights(&linear), false);
    }
}

#[test]
fn projection_inverts_expansion_and_measures_the_rest() {
    for group in Group::ALL {
        let mixed = FieldType::new(group, [2, 1, 1, 0]);
        let conv = layer(group.regular_type(2), mixed, 3);
        let dense = conv.as_ordinary_conv();
        let mut params = common::params::<f64>(&conv, 1);
        let weights = num_weights(&conv);
        params[weights..].fill(0.0);
        let steerable = dense.kernel(&params);
        let back = dense.project_kernel(&steerable);
        assert!(back.lost_share < 1e-14, "{group}");
        for (a, b) in params.iter().zip(&back.params) {
            assert!((a - b).abs() < 1e-14);
        }
        // of noise remains what is orthogonal to all kernels
        let noise = normal::<f64>(steerable.len(), 2);
        let basis = basis(&dense, weights, false);
        let kept: f64 = basis.iter().map(|kernel| dot(kernel, &noise).powi(2)).sum();
        let expected = 1.0 - kept / dot(&noise, &noise);
        assert!((dense.project_kernel(&noise).lost_share.powi(2) - expected).abs() < 1e-12);
    }
}

#[test]
fn the_regular_basis_projects_to_the_same_parameters() {
    for group in Group::ALL {
        let conv = layer(group.trivial_type(2), group.regular_type(2), 4);
        let params = common::params::<f64>(&conv, 3);
        let kernel = conv.as_ordinary_conv().regular_basis_kernel(&params);
        let back = conv.as_ordinary_conv().project_regular_basis_kernel(&kernel);
        assert!(back.lost_share < 1e-14);
        let weights = num_weights(&conv);
        for (a, b) in params[..weights].iter().zip(&back.params) {
            assert!((a - b).abs() < 1e-14);
        }
    }
}

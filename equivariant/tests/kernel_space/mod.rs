//! The closed form of steerable kernels against the general solver of the kernel constraint.

mod solver;

use equivariant::{FieldType, Group, Layer, Linear, OrdinaryConv, R2Conv, SlidingWindow};
use proptest::prelude::*;
use solver::{Representation, kernel_space};

use crate::common::{self, normal};

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the part of `kernel` outside the span of an orthonormal basis, relative to it.
fn outside(kernel: &[f64], basis: &[Vec<f64>]) -> f64 {
    let mut rest = kernel.to_vec();
    for b in basis {
        let along = dot(kernel, b);
        rest.iter_mut().zip(b).for_each(|(r, b)| *r -= along * b);
    }
    (dot(&rest, &rest) / dot(kernel, kernel)).sqrt()
}

/// Returns the kernels of the unit vectors among the weights.
fn closed_form(dense: &OrdinaryConv, weights: usize, regular: bool) -> Vec<Vec<f64>> {
    let biases = dense.out_shape().fields.multiplicity(symmetry::Irrep::Trivial);
    let kernel = |i| {
        let mut unit = vec![0.0; weights + biases];
        unit[i] = 1.0;
        if regular { dense.regular_kernel(&unit) } else { dense.kernel(&unit) }
    };
    (0..weights).map(kernel).collect()
}

fn num_weights(layer: &dyn Layer<f64>) -> usize {
    layer.num_params() - layer.out_shape().fields.multiplicity(symmetry::Irrep::Trivial)
}

/// Checks that the kernels are an orthonormal basis of the space that the solver found.
fn assert_equal_spans(closed: &[Vec<f64>], solved: &[Vec<f64>]) {
    assert_eq!(closed.len(), solved.len(), "dimensions differ");
    for (i, a) in closed.iter().enumerate() {
        assert!(outside(a, solved) < 1e-12);
        for (j, b) in closed[..=i].iter().enumerate() {
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
        let solved = kernel_space(
            &Representation::irreps(in_type),
            &Representation::irreps(out_type),
            size,
        );
        assert_equal_spans(&closed_form(&conv.as_ordinary_conv(), num_weights(&conv), false), &solved);
    }
}

#[test]
fn regular_kernels_span_the_space_of_permutation_representations() {
    for group in Group::ALL {
        for size in [2, 3] {
            let conv = layer(group.regular_type(1), group.regular_type(1), size);
            let regular = Representation::regular(group, 1);
            let solved = kernel_space(&regular, &regular, size);
            let closed = closed_form(&conv.as_ordinary_conv(), num_weights(&conv), true);
            assert_equal_spans(&closed, &solved);
        }
    }
}

#[test]
fn linear_layers_span_the_equivariant_matrices() {
    for group in Group::ALL {
        let (in_type, out_type) = (group.regular_type(2), FieldType::new(group, [2, 1, 0, 1]));
        let linear = Linear::new(in_type, out_type).unwrap();
        let solved =
            kernel_space(&Representation::irreps(in_type), &Representation::irreps(out_type), 1);
        let closed = closed_form(&linear.as_ordinary_conv(), num_weights(&linear), false);
        assert_equal_spans(&closed, &solved);
    }
}

#[test]
fn a_kernel_that_is_not_steerable_lies_outside() {
    let (fields, size) = (Group::D2.regular_type(1), 3);
    let rho = Representation::irreps(fields);
    let solved = kernel_space(&rho, &rho, size);
    assert!(outside(&normal(16 * 9, 1), &solved) > 0.5);
}

#[test]
fn the_solver_does_not_depend_on_the_basis() {
    // the regular representation of C2, turned by an angle
    let (s, c) = 0.7f64.sin_cos();
    let turned = vec![
        vec![1.0, 0.0, 0.0, 1.0],
        vec![2.0 * s * c, c * c - s * s, c * c - s * s, -2.0 * s * c],
    ];
    let turned = Representation::new(Group::C2, 2, turned);
    let regular = Representation::regular(Group::C2, 1);
    for size in [1, 2, 3] {
        let dimension = |rho| kernel_space(rho, rho, size).len();
        assert_eq!(dimension(&turned), dimension(&regular));
        assert_eq!(dimension(&turned), 2 * size * size);
    }
}

#[test]
#[should_panic(expected = "rho(half turn) rho(half turn) is not rho(identity)")]
fn matrices_that_are_no_representation_are_refused() {
    Representation::new(Group::C2, 1, vec![vec![1.0], vec![2.0]]);
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
        // the norms of noise: the part that remains must be what the oracle finds
        let noise = normal::<f64>(steerable.len(), 2);
        let solved = kernel_space(
            &Representation::irreps(group.regular_type(2)),
            &Representation::irreps(mixed),
            3,
        );
        let expected = outside(&noise, &solved);
        assert!((dense.project_kernel(&noise).lost_share - expected).abs() < 1e-12);
    }
}

#[test]
fn the_regular_basis_projects_to_the_same_parameters() {
    for group in Group::ALL {
        let conv = layer(group.trivial_type(2), group.regular_type(2), 4);
        let params = common::params::<f64>(&conv, 3);
        let kernel = conv.as_ordinary_conv().regular_kernel(&params);
        let back = conv.as_ordinary_conv().project_regular_kernel(&kernel);
        assert!(back.lost_share < 1e-14);
        let weights = num_weights(&conv);
        for (a, b) in params[..weights].iter().zip(&back.params) {
            assert!((a - b).abs() < 1e-14);
        }
        // in the regular basis, a bias is one number for all elements of a field
        let bias = conv.as_ordinary_conv().regular_bias(&params);
        for f in 0..2 {
            let values: Vec<f64> = bias.iter().skip(f).step_by(2).copied().collect();
            assert!(values.iter().all(|v| (v - values[0]).abs() < 1e-15));
        }
    }
}

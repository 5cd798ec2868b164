//! f(g x) = g f(x) for every layer, and tests that the checker can fail.

use equivariant::{
    FieldType, Group, InstructionSet, Layer, R2Conv, Relu, Scalar, Sequential, Shape, TestLayer,
    equivariance_error, equivariance_error_of_fn, test_layers,
};

use crate::common::{boxed, concat, conv, kernel, layers, params, rng};

fn worst<T: Scalar>(tolerance: f64) {
    for (name, layer) in layers::<T>() {
        let params = params(layer.as_ref(), 4);
        let error = equivariance_error(layer.as_ref(), &params, 5, &mut rng(5));
        assert!(error < tolerance, "{name}: error {error}");
    }
}

#[test]
fn layers_are_equivariant_in_both_precisions() {
    worst::<f64>(1e-12);
    worst::<f32>(1e-5);
}

#[test]
fn layers_that_only_permute_and_compare_are_exact() {
    for group in Group::ALL {
        let exact = test_layers::<f32>(group).unwrap().into_iter();
        let exact: Vec<_> = exact.filter(|of| of.is_exactly_equivariant).collect();
        assert!(exact.len() >= 12, "{} of {group}", exact.len());
        for TestLayer { name, layer, .. } in exact {
            let error = equivariance_error(layer.as_ref(), &[], 5, &mut rng(5));
            assert_eq!(error, 0.0, "{name} of {group}");
        }
    }
}

#[test]
fn sums_of_maps_commute_with_every_group() {
    for group in Group::ALL {
        let concat = concat(group);
        let sum = |x: &[f32], y: &[f32]| {
            let mut sum = vec![0.0; concat.out_shape().len()];
            concat.forward(x, y, &mut sum);
            sum
        };
        let [a, b] = concat.in_shapes();
        let x: Vec<f32> = (0..a.len()).map(|i| (i as f32).sin()).collect();
        let y: Vec<f32> = (0..b.len()).map(|i| (i as f32).cos()).collect();
        for &g in group.elements() {
            let of_moved = sum(&a.transform_sample(g, &x), &b.transform_sample(g, &y));
            let moved = concat.out_shape().transform_sample(g, &sum(&x, &y));
            assert_eq!(of_moved, moved, "{group} {g}");
        }
    }
}

fn assert_exact<T: Scalar>(layer: &dyn Layer<T>) {
    let error = equivariance_error(layer, &params(layer, 1), 3, &mut rng(2));
    assert_eq!(error, 0.0, "{layer}");
}

/// Checks lines of output that are whole tiles of pixels, have a remainder or are shorter, for
/// numbers of channels with and without specialised code.
#[test]
fn first_layers_are_exact_under_d2() {
    for channels in [1, 3, 4, 6, 7] {
        for (window, sides) in [([4, 2, 1], [6, 16, 22, 26]), ([3, 1, 1], [3, 8, 11, 13])] {
            for side in sides {
                let (from, to) = (Group::D2.trivial_type(channels), Group::D2.regular_type(5));
                let conv = R2Conv::new(from, to, kernel(window), [6, side]).unwrap();
                let sets = InstructionSet::ALL.into_iter();
                for set in sets.filter(|set| set.is_available()) {
                    assert_exact::<f32>(&conv.clone().limit_instruction_set(set));
                }
                assert_exact::<f64>(&conv);
            }
        }
    }
}

/// Checks odd and even windows, with more rows than a tile and a remainder.
#[test]
fn convolutions_are_exactly_equivariant() {
    for group in Group::ALL {
        for (window, size) in [([4, 2, 1], 16), ([3, 1, 1], 7), ([3, 2, 1], 7), ([5, 1, 0], 9)] {
            let regular = group.regular_type(3);
            let first = conv(group.trivial_type(3), regular, window, [size; 2]);
            let relu = boxed(Relu::new(first.out_shape()));
            let side = first.out_shape().height;
            let second = conv(regular, regular, [3, 1, 1], [side; 2]);
            let net = Sequential::<f32>::new(vec![first, relu, second]).unwrap();
            let error = equivariance_error(&net, &params(&net, 1), 3, &mut rng(5));
            assert_eq!(error, 0.0, "{window:?} of {group}");
        }
    }
}

fn identity_between(in_shape: Shape, out_shape: Shape) -> f64 {
    let copy = |x: &[f64], y: &mut [f64]| y.copy_from_slice(x);
    equivariance_error_of_fn(in_shape, out_shape, copy, 3, &mut rng(0))
}

#[test]
fn the_checker_refuses_wrong_actions_and_pointwise_maps_of_odd_channels() {
    let right = Shape::image(2, 3, FieldType::new(Group::D2, [1, 1, 0, 0]));
    let wrong = Shape::image(2, 3, FieldType::new(Group::D2, [1, 0, 1, 0]));
    assert_eq!(identity_between(right, right), 0.0);
    assert!(identity_between(right, wrong) > 0.1);
    let tall = Shape::image(3, 2, Group::D2.trivial_type(1));
    let wide = Shape::image(2, 3, Group::D2.trivial_type(1));
    assert!(identity_between(tall, wide) > 0.1);
    let shape = Shape::vector(FieldType::new(Group::D2, [0, 4, 0, 0]));
    let relu = |x: &[f32], y: &mut [f32]| {
        for (out, &value) in y.iter_mut().zip(x) {
            *out = value.max(0.0);
        }
    };
    assert!(equivariance_error_of_fn(shape, shape, relu, 3, &mut rng(0)) > 0.1);
}

#[test]
fn the_checker_applies_every_element_of_the_group() {
    // x and y are exchanged, which the half turn leaves invariant
    let swapped = |group: Group| {
        let shape = Shape::vector(FieldType::new(group, [0, 1, 1, 0]));
        let f = |v: &[f64], y: &mut [f64]| y.copy_from_slice(&[v[1], v[0]]);
        equivariance_error_of_fn(shape, shape, f, 3, &mut rng(0))
    };
    assert_eq!(swapped(Group::C1), 0.0);
    assert_eq!(swapped(Group::C2), 0.0);
    for group in [Group::D1x, Group::D1y, Group::D2] {
        assert!(swapped(group) > 0.1, "{group}");
    }
}

#[test]
fn the_checker_refuses_outputs_that_are_not_finite_or_not_written() {
    let shape = Shape::vector(Group::D2.trivial_type(2));
    for written in [0, 1, 2] {
        let f = |_: &[f64], y: &mut [f64]| y[..written].fill(f64::NAN);
        assert_eq!(equivariance_error_of_fn(shape, shape, f, 1, &mut rng(0)), f64::INFINITY);
    }
}

#[test]
#[should_panic(expected = "got an output of D1y, expected one of D1x or of a subgroup")]
fn the_checker_refuses_an_output_of_another_group() {
    let [from, to] = [Group::D1x, Group::D1y].map(|group| Shape::vector(group.trivial_type(1)));
    identity_between(from, to);
}

#[test]
#[should_panic(expected = "got 0 trials, expected at least 1")]
fn the_checker_refuses_no_trials() {
    let shape = Shape::vector(Group::D2.trivial_type(2));
    let copy = |x: &[f64], y: &mut [f64]| y.copy_from_slice(x);
    equivariance_error_of_fn(shape, shape, copy, 0, &mut rng(0));
}

//! Wrong types, shapes, sizes and slices: refused with the layer's name, what was got and what was expected.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{exact_layers_of, inexact_layers_of, kernel};
use equivariant::{
    AveragePool, Concat, FieldNorm, FieldType, Group, GroupMaxPool, GroupMeanPool, Layer,
    LayerError, Linear, MaxPool, R2Conv, Relu, Shape, SpatialSoftArgmax, Statistics,
};

fn message<L>(refused: Result<L, LayerError>) -> String {
    refused.err().unwrap().to_string()
}

#[test]
fn errors_name_the_layer_what_was_got_and_what_was_expected() {
    let (d2, c2) = (Group::D2.regular(2), Group::C2.regular(2));
    let mixed = Shape::image(4, 4, FieldType::new(Group::D2, [8, 10, 8, 8]));
    let odd = Shape::image(5, 6, d2);
    let halving = kernel([2, 2, 0]);
    let of_type = "got the type `8 reg + 2 x`, expected regular fields only";
    let of_groups = "got the types `2 reg` of D2 and `C2: 2 reg` of C2, expected one group";
    let of_size = "D2 flips the height, and a window of 2 pixels, stride 2 and padding 0 leaves a \
                   remainder there: got (5 + 2 * 0 - 2) mod 2 = 1, expected 0";
    let of_window = "got a window of 7 pixels, stride 1 and padding 0 on the height of 5, \
                     expected 1 <= 7 <= 5 + 2 * 0";
    let large = kernel([7, 1, 0]);
    let refused = [
        ("Relu", of_type, message(Relu::new(mixed))),
        ("GroupMaxPool", of_type, message(GroupMaxPool::new(mixed))),
        ("GroupMeanPool", of_type, message(GroupMeanPool::new(mixed))),
        ("MaxPool", of_type, message(MaxPool::new(mixed, halving))),
        (
            "SpatialSoftArgmax",
            of_type,
            message(SpatialSoftArgmax::new(mixed, 1.0)),
        ),
        (
            "R2Conv",
            of_groups,
            message(R2Conv::new(d2, c2, halving, [4, 4])),
        ),
        ("Linear", of_groups, message(Linear::new(d2, c2))),
        (
            "Concat",
            of_groups,
            message(Concat::new(Shape::vector(d2), Shape::vector(c2))),
        ),
        (
            "R2Conv",
            of_size,
            message(R2Conv::new(d2, d2, halving, [5, 6])),
        ),
        ("MaxPool", of_size, message(MaxPool::new(odd, halving))),
        (
            "AveragePool",
            of_size,
            message(AveragePool::new(odd, halving)),
        ),
        (
            "R2Conv",
            of_window,
            message(R2Conv::new(d2, d2, large, [5, 6])),
        ),
        ("MaxPool", of_window, message(MaxPool::new(odd, large))),
        (
            "R2Conv::flatten",
            "got a map of 5 x 6 pixels, expected a square one",
            message(R2Conv::flatten(odd, d2)),
        ),
        (
            "Concat",
            "got maps of 5 x 6 and 4 x 4 pixels, expected equal heights and widths",
            message(Concat::new(odd, mixed)),
        ),
        (
            "FieldNorm",
            "got the fixed statistics [], expected a finite mean",
            message(FieldNorm::new(odd, Statistics::Fixed(vec![]))),
        ),
    ];
    for (layer, reason, message) in refused {
        let expected = format!("{layer}: {reason}");
        assert!(message.starts_with(&expected), "{message}\n{expected}");
    }
}

/// What a call with an output that is one value short says.
fn panic_of(layer: &dyn Layer<f32>) -> String {
    let params = vec![0.0; layer.num_params()];
    let x = vec![0.0; 2 * layer.in_shape().len()];
    let mut y = vec![0.0; 2 * layer.out_shape().len() - 1];
    let mut scratch = vec![0.0; layer.scratch_len(2)];
    let call = || layer.forward(&params, &x, &mut y, &mut scratch);
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(call)).unwrap_err();
    panic.downcast_ref::<String>().unwrap().clone()
}

#[test]
fn slices_of_wrong_lengths_are_refused_by_the_layers_name() {
    let all = [
        exact_layers_of::<f32>(Group::C2),
        inexact_layers_of(Group::C2),
    ];
    let kinds = [
        "MaxPool",
        "AveragePool",
        "GroupMeanPool",
        "SpatialSoftArgmax",
        "FieldNorm",
    ];
    let mut seen = Vec::new();
    for (_, layer) in all.into_iter().flatten() {
        let printed = layer.to_string();
        let kind = printed.split('(').next().unwrap();
        if kinds.contains(&kind) {
            let message = panic_of(layer.as_ref());
            assert!(
                message.starts_with(&format!("{kind}: got an input of")),
                "{message}"
            );
            seen.push(kind.to_owned());
        }
    }
    assert!(kinds.iter().all(|kind| seen.iter().any(|s| s == kind)));
}

//! Wrong types, shapes, sizes and slices: refused with the layer's name, what was got and what was
//! expected.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::kernel;
use equivariant::{
    AveragePool, Concat, FieldNorm, FieldType, Group, GroupMaxPool, GroupMeanPool, LayerError,
    Linear, MaxPool, R2Conv, Relu, Shape, SpatialSoftArgmax, Statistics,
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
            "got the fixed statistics [], expected a mean and a variance of at least 0",
            message(FieldNorm::new(odd, Statistics::Fixed(vec![]))),
        ),
    ];
    for (layer, reason, message) in refused {
        let expected = format!("{layer}: {reason}");
        assert!(message.starts_with(&expected), "{message}\n{expected}");
    }
}

#[test]
fn maps_without_values_are_refused() {
    let none = Group::D2.trivial(0);
    let some = Group::D2.regular(2);
    let one = kernel([1, 1, 0]);
    let refused = |shape: Shape| {
        [
            message(Relu::new(shape)),
            message(GroupMaxPool::new(shape)),
            message(GroupMeanPool::new(shape)),
            message(MaxPool::new(shape, one)),
            message(AveragePool::new(shape, kernel([2, 1, 1]))),
            message(SpatialSoftArgmax::new(shape, 1.0)),
            message(FieldNorm::new(shape, Statistics::Batch)),
            message(R2Conv::new(
                shape.fields,
                some,
                kernel([2, 1, 1]),
                [shape.height, shape.width],
            )),
            message(Concat::new(shape, shape)),
        ]
    };
    let empty = [
        Shape::image(2, 3, none),
        Shape::image(0, 3, some),
        Shape::image(2, 0, some),
    ];
    for shape in empty {
        for message in refused(shape) {
            let map = format!("got a map of {shape}, expected at least one pixel and one channel");
            let window = "expected 1 <= 1 <= 0 + 2 * 0";
            assert!(
                message.ends_with(&map) || message.contains(window),
                "{message}"
            );
        }
    }
    for (from, to) in [(none, some), (some, none)] {
        assert!(message(Linear::new(from, to)).contains("got a map of 1 x 1 x ("));
        assert!(message(R2Conv::new(from, to, one, [2, 3])).contains("got a map of 2 x 3 x ("));
    }
}

#[test]
fn more_output_channels_than_a_type_holds_are_refused() {
    let half = FieldType::MAX_DIM / 2;
    let map = |channels| Shape::vector(Group::C2.trivial(channels));
    let refused = [
        message(Concat::new(map(half), map(half + 1))),
        message(SpatialSoftArgmax::new(map(half + 1), 1.0)),
    ];
    for message in refused {
        let expected = "got the number of output channels 1677721";
        assert!(message.contains(expected), "{message}");
    }
    Concat::new(map(half), map(half)).unwrap();
    SpatialSoftArgmax::new(map(half), 1.0).unwrap();
}

#[test]
fn sizes_that_no_memory_holds_are_refused() {
    let large = 1 << 40;
    let (many, one) = (Group::C1.trivial(FieldType::MAX_DIM), Group::C1.trivial(1));
    let window = kernel([3, 1, 1]);
    let padded = kernel([3, 1, usize::MAX / 2 + 1]);
    let wide = Shape::image(2, large, one);
    for message in [
        message(R2Conv::new(one, one, window, [large, large])),
        message(R2Conv::new(one, one, kernel([3, 1, large]), [5, 7])),
        message(R2Conv::new(many, many, window, [5, 7])),
        message(R2Conv::new(
            Group::C1.trivial(1 << 20),
            Group::C1.trivial(1 << 20),
            window,
            [5, 7],
        )),
        message(Linear::new(many, many)),
        message(Linear::new(
            Group::C1.trivial(1 << 20),
            Group::C1.trivial(1 << 20),
        )),
        message(Relu::new(wide)),
        message(MaxPool::new(wide, window)),
        message(AveragePool::new(wide, window)),
        message(AveragePool::new(
            Shape::image(2, 3, one),
            kernel([large, 1, large / 2]),
        )),
        message(GroupMaxPool::new(wide)),
        message(FieldNorm::new(wide, Statistics::Sample)),
        message(SpatialSoftArgmax::new(wide, 1.0)),
    ] {
        assert!(
            message.contains("of more than 2147483648 values, expected at most that"),
            "{message}"
        );
    }
    // 5 + 2 * padding is 5 in arithmetic that wraps
    let message = message(R2Conv::new(one, one, padded, [5, 7]));
    assert!(
        message.contains("on the height of 5, expected 1 <= 3 <= 5"),
        "{message}"
    );
}

//! Wrong types, shapes, sizes and slices are rejected with the layer's name, the value and the
//! expectation.

use equivariant::{
    Concat, FieldType, Group, GroupMaxPool, LayerError, Linear, MaxPool, R2Conv, Relu, Shape,
    SlidingWindow,
};

fn message<L>(refused: Result<L, LayerError>) -> String {
    refused.err().unwrap().to_string()
}

/// Checks that each layer is rejected with its name and the reason.
fn assert_refused<const N: usize>(reason: &str, refused: [(&str, String); N]) {
    for (layer, message) in refused {
        let expected = format!("{layer}: {reason}");
        assert!(message.starts_with(&expected), "{message}\n{expected}");
    }
}

#[test]
fn types_that_a_layer_does_not_take_are_refused() {
    for fields in ["8 reg + 2 x", "1 x", "4 1", "C2: 4 1"] {
        let shape = Shape::image(4, 4, fields.parse().unwrap());
        let reason = format!("got the type `{fields}`, expected regular fields only");
        assert_refused(&reason, [("GroupMaxPool", message(GroupMaxPool::new(shape)))]);
        // the others take trivial channels, too
        if !shape.fields.is_trivial() {
            let pool = MaxPool::new(shape, SlidingWindow::new(2, 2, 0));
            let others = [("Relu", message(Relu::new(shape))), ("MaxPool", message(pool))];
            assert_refused(&reason, others);
        }
    }
}

#[test]
fn types_of_two_groups_are_refused() {
    let (d2, c2) = (Group::D2.regular_type(2), Group::C2.regular_type(2));
    let conv = R2Conv::new(d2, c2, SlidingWindow::new(2, 2, 0), [4, 4]);
    let concat = Concat::new(Shape::vector(d2), Shape::vector(c2));
    let refused = [
        ("R2Conv", message(conv)),
        ("Linear", message(Linear::new(d2, c2))),
        ("Concat", message(concat)),
    ];
    let reason = "got the types `2 reg` of D2 and `C2: 2 reg` of C2, expected one group";
    assert_refused(reason, refused);
}

#[test]
fn windows_that_are_inexact_or_do_not_fit_are_refused() {
    let fields = Group::D2.regular_type(2);
    let image = Shape::image(5, 6, fields);
    let refused = |window| {
        [
            ("R2Conv", message(R2Conv::new(fields, fields, window, [5, 6]))),
            ("MaxPool", message(MaxPool::new(image, window))),
        ]
    };
    let inexact = "D2 flips the height, and a window of 2 pixels, stride 2 and padding 0 leaves a \
                   remainder there: got (5 + 2 * 0 - 2) mod 2 = 1, expected 0";
    let too_large = "got a window of 7 pixels, stride 1 and padding 0 on the height of 5, \
                     expected 1 <= 7 <= 5 + 2 * 0";
    assert_refused(inexact, refused(SlidingWindow::new(2, 2, 0)));
    assert_refused(too_large, refused(SlidingWindow::new(7, 1, 0)));
    let wide = |window| message(R2Conv::new(fields, fields, window, [6, 5]));
    assert!(wide(SlidingWindow::new(2, 2, 0)).contains("D2 flips the width"));
    assert!(wide(SlidingWindow::new(6, 1, 0)).contains("on the width of 5"));
    for none in [SlidingWindow::new(0, 1, 0), SlidingWindow::new(3, 0, 0)] {
        assert_refused("got a window of", refused(none));
    }
}

#[test]
fn maps_and_settings_that_do_not_fit_are_refused() {
    let fields = Group::D2.regular_type(2);
    let [odd, even] = [[5, 6], [4, 4]].map(|[height, width]| Shape::image(height, width, fields));
    let flatten = ("R2Conv::flattening", message(R2Conv::flattening(odd, fields)));
    assert_refused("got the map of 5 x 6 pixels, expected a square one", [flatten]);
    let concat = ("Concat", message(Concat::new(odd, even)));
    let sizes = "got the maps 5 x 6 x (2 reg) and 4 x 4 x (2 reg), expected equal heights and";
    assert_refused(sizes, [concat]);
}

#[test]
fn maps_without_values_are_refused() {
    let none = Group::D2.trivial_type(0);
    let some = Group::D2.regular_type(2);
    let one = SlidingWindow::new(1, 1, 0);
    let refused = |shape: Shape| {
        [
            message(Relu::new(shape)),
            message(GroupMaxPool::new(shape)),
            message(MaxPool::new(shape, one)),
            message(R2Conv::new(
                shape.fields,
                some,
                SlidingWindow::new(2, 1, 1),
                [shape.height, shape.width],
            )),
            message(Concat::new(shape, shape)),
        ]
    };
    let empty = [Shape::image(2, 3, none), Shape::image(0, 3, some), Shape::image(2, 0, some)];
    for shape in empty {
        for message in refused(shape) {
            let map = format!("got a map of {shape}, expected at least one pixel and one channel");
            let window = "expected 1 <= 1 <= 0 + 2 * 0";
            assert!(message.ends_with(&map) || message.contains(window), "{message}");
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
    let map = |channels| Shape::vector(Group::C2.trivial_type(channels));
    let message = message(Concat::new(map(half), map(half + 1)));
    assert!(message.contains("got the number of output channels 1677721"), "{message}");
    Concat::new(map(half), map(half)).unwrap();
}

#[test]
fn sizes_that_no_memory_holds_are_refused() {
    let large = 1 << 40;
    let (many, one) = (Group::C1.trivial_type(FieldType::MAX_DIM), Group::C1.trivial_type(1));
    let window = SlidingWindow::new(3, 1, 1);
    let padded = SlidingWindow::new(3, 1, usize::MAX / 2 + 1);
    let wide = Shape::image(2, large, one);
    for message in [
        message(R2Conv::new(one, one, window, [large, large])),
        message(R2Conv::new(one, one, SlidingWindow::new(3, 1, large), [5, 7])),
        message(R2Conv::new(many, many, window, [5, 7])),
        message(R2Conv::new(
            Group::C1.trivial_type(1 << 20),
            Group::C1.trivial_type(1 << 20),
            window,
            [5, 7],
        )),
        message(Linear::new(many, many)),
        message(Linear::new(Group::C1.trivial_type(1 << 20), Group::C1.trivial_type(1 << 20))),
        message(Relu::new(wide)),
        message(MaxPool::new(wide, window)),
        message(MaxPool::new(Shape::image(5, 7, one), padded)),
        message(GroupMaxPool::new(wide)),
    ] {
        assert!(
            message.contains("of more than 2147483648 values, expected at most that"),
            "{message}"
        );
    }
    // 5 + 2 * padding is 5 in arithmetic that wraps
    let message = message(R2Conv::new(one, one, padded, [5, 7]));
    assert!(message.contains("on the height of 5, expected 1 <= 3 <= 5"), "{message}");
}

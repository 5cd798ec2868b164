//! Slices and scratches of wrong lengths are rejected by every layer, with the name of the slice.

use equivariant::{BranchSum, Concat, Group, Layer, MaxPool, Relu, Scratch, Sequential, Shape};

use crate::common::{boxed, kernel, layers, normal, panic_of, rng};

const SAMPLES: usize = 3;

/// Names of the slices of a pass, in the order of their lengths here.
const SLICES: [&str; 7] = ["params", "x", "y", "dy", "dx", "dparams", "scratch"];

fn lengths(layer: &dyn Layer<f32>) -> [usize; 7] {
    let (x, y) = (SAMPLES * layer.in_shape().len(), SAMPLES * layer.out_shape().len());
    let params = layer.num_params();
    [params, x, y, y, x, params, layer.scratch_len(SAMPLES)]
}

type Pass = fn(&dyn Layer<f32>, [usize; 7]);

fn forward(layer: &dyn Layer<f32>, lengths: [usize; 7]) {
    let [params, x, y, .., scratch] = lengths;
    let mut y = vec![0.0; y];
    let mut scratch = Scratch::new_filled(scratch, 0.0);
    layer.forward(&vec![0.1; params], &vec![0.1; x], &mut y, &mut scratch);
}

/// Runs a backward pass after a forward pass of the right lengths.
fn backward(layer: &dyn Layer<f32>, lengths: [usize; 7]) {
    let [params, x, y, ..] = self::lengths(layer);
    let mut scratch = layer.allocate_scratch(SAMPLES);
    let (mut y, x) = (vec![0.0; y], vec![0.1; x]);
    layer.forward(&vec![0.1; params], &x, &mut y, &mut scratch);
    let [params_len, x_len, y_len, dy, dx, dparams, len] = lengths;
    let (mut dx, mut dparams) = (vec![0.0; dx], vec![0.0; dparams]);
    if len < scratch.len() {
        scratch = Scratch::new_filled(len, 0.0);
    }
    layer.backward(
        &vec![0.1; params_len],
        &vec![0.1; x_len],
        &vec![0.1; y_len],
        &vec![0.1; dy],
        Some(&mut dx),
        &mut dparams,
        &mut scratch,
    );
}

/// Returns `true` if the message names the slice, its length and the expected one. A wrong `x` of
/// whole samples makes the other slices wrong, whose messages name it.
fn names(message: &str, slice: usize, got: usize, right: usize) -> bool {
    let named = format!("got {} of {got} values, expected {right}", SLICES[slice]);
    match SLICES[slice] {
        "x" if got.is_multiple_of(right / SAMPLES) => {
            message.ends_with("as its shapes and x require")
        }
        "x" => {
            let each = right / SAMPLES;
            message.ends_with(&format!("got x of {got} values, expected a multiple of {each}"))
        }
        "scratch" => {
            let scratch_message =
                format!("got a scratch of {got} values, expected at least {right}");
            message.contains(&scratch_message)
                || message.contains("got a scratch that forward left for 0")
        }
        _ => message.contains(&named),
    }
}

/// Checks that the length is rejected in both passes, as far as they have the slice.
fn assert_refused(name: &str, layer: &dyn Layer<f32>, slice: usize, wrong: usize) {
    let mut lengths = lengths(layer);
    let right = std::mem::replace(&mut lengths[slice], wrong);
    let mut passes: Vec<Pass> = vec![backward];
    if ["params", "x", "y", "scratch"].contains(&SLICES[slice]) {
        passes.push(forward);
    }
    for pass in passes {
        let message = panic_of(|| pass(layer, lengths));
        let message = message.unwrap_or_else(|| panic!("{name}: {} of {wrong}", SLICES[slice]));
        assert!(names(&message, slice, wrong, right), "{name}: {message}");
        assert!(message.starts_with(&layer.to_string()), "{name}: {message}");
    }
}

#[test]
fn right_lengths_are_taken() {
    for (_, layer) in layers::<f32>() {
        let mut lengths = lengths(layer.as_ref());
        for spare in [0, 1, 40] {
            lengths[6] += spare;
            forward(layer.as_ref(), lengths);
            backward(layer.as_ref(), lengths);
        }
    }
}

#[test]
fn lengths_beside_the_right_one_are_refused_by_every_layer() {
    for (name, layer) in layers::<f32>() {
        for (slice, right) in lengths(layer.as_ref()).into_iter().enumerate() {
            let larger = if SLICES[slice] == "scratch" { right } else { right + 1 };
            for wrong in [0, right.saturating_sub(1), larger, 2 * right] {
                if wrong == right || (SLICES[slice] == "scratch" && wrong > right) {
                    continue;
                }
                assert_refused(&name, layer.as_ref(), slice, wrong);
            }
        }
    }
}

#[test]
fn initial_weights_need_all_parameters() {
    for (name, layer) in layers::<f32>() {
        let right = layer.num_params();
        for wrong in [right + 1, right.saturating_sub(1)] {
            let mut params = vec![0.0; wrong];
            let message = panic_of(|| layer.init(&mut rng(0), &mut params));
            let expected = format!("got params of {wrong} values, expected {right}");
            assert!(wrong == right || message.unwrap().contains(&expected), "{name}");
        }
    }
}

#[test]
fn a_scratch_of_another_number_of_samples_is_refused_where_it_is_kept() {
    for (name, layer) in layers::<f32>().into_iter().filter(|(_, l)| l.backward_reads_scratch()) {
        let params = vec![0.1; layer.num_params()];
        let x = normal::<f32>(SAMPLES * layer.in_shape().len(), 1);
        let mut y = vec![0.0; SAMPLES * layer.out_shape().len()];
        let mut scratch = layer.allocate_scratch(SAMPLES);
        layer.forward(&params, &x, &mut y, &mut scratch);
        let (x, y) = (&x[..layer.in_shape().len()], &y[..layer.out_shape().len()]);
        let mut dparams = vec![0.0; params.len()];
        let call = || layer.backward(&params, x, y, y, None, &mut dparams, &mut scratch);
        let message = panic_of(call).unwrap();
        let expected = "got a scratch that forward left for 3 samples, expected one for the 1 of x";
        assert!(message.contains(expected), "{name}: {message}");
    }
}

#[test]
fn a_scratch_of_another_layer_is_refused_where_it_is_kept() {
    let map = Shape::image(4, 4, Group::D2.regular_type(2));
    let pool = |window| boxed::<f32, _>(MaxPool::new(map, kernel(window)));
    let relu = || boxed::<f32, _>(Relu::new(map));
    let sum = |branches| boxed(BranchSum::new(branches));
    let residual = || boxed(BranchSum::residual(relu()));
    let chain = |layer| -> Box<dyn Layer<f32>> { boxed(Sequential::new(vec![layer])) };
    let pairs = [
        [residual(), sum(vec![relu(), relu()])],
        [chain(residual()), chain(sum(vec![relu(), relu()]))],
        [chain(pool([3, 1, 1])), chain(pool([1, 1, 0]))],
    ];
    for [own, foreign] in pairs {
        let x = normal::<f32>(SAMPLES * map.len(), 1);
        let mut y = vec![0.0; SAMPLES * own.out_shape().len()];
        assert_eq!(own.out_shape(), foreign.out_shape());
        let len = own.scratch_len(SAMPLES).max(foreign.scratch_len(SAMPLES));
        let mut scratch = Scratch::new_filled(len, 0.0);
        own.forward(&[], &x, &mut y, &mut scratch);
        own.backward(&[], &x, &y, &y, None, &mut [], &mut scratch);
        foreign.forward(&[], &x, &mut y, &mut scratch);
        let call = || own.backward(&[], &x, &y, &y, None, &mut [], &mut scratch);
        let message = panic_of(call).unwrap();
        let expected = "got a scratch that forward of another layer left";
        assert!(message.contains(expected), "{own}: {message}");
    }
}

#[test]
fn sums_of_maps_refuse_wrong_lengths() {
    let shapes =
        [Group::D2.regular_type(2), Group::D2.trivial_type(3)].map(|t| Shape::image(2, 3, t));
    let concat = Concat::new(shapes[0], shapes[1]).unwrap();
    let right = [shapes[0].len(), shapes[1].len(), concat.out_shape().len()].map(|n| 2 * n);
    for slice in 0..3 {
        for wrong in [0, right[slice] - 1, right[slice] + 1] {
            let mut lengths = right;
            lengths[slice] = wrong;
            let [mut first, mut second, mut sum] = lengths.map(|len| vec![0.0f32; len]);
            let forward = panic_of(|| concat.forward(&first, &second, &mut sum));
            let backward = panic_of(|| concat.backward(&sum, &mut first, &mut second));
            for message in [forward.unwrap(), backward.unwrap()] {
                assert!(
                    message.starts_with("Concat(2 x 3 x (2 reg), 2 x 3 x (3 1)): got "),
                    "{message}"
                );
                assert!(message.contains(" values, expected "), "{message}");
            }
        }
    }
}

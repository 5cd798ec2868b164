//! Half precision gives what single precision gives, but for the rounding of what it multiplies.

use equivariant::{
    FieldType, Group, Half, Kernel, Layer, MaxPool, R2Conv, Relu, Scalar, Sequential, Shape,
    Signature, equivariance_error,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::common::{params, scratch, unwritten};

/// Output, gradient of the input and gradient of the parameters.
type Passes<T> = [Vec<T>; 3];

fn run<T: Scalar>(layer: &dyn Layer<T>, params: &[f32], x: &[f32], with_dx: bool) -> Passes<T> {
    let of = |values: &[f32]| -> Vec<T> { values.iter().map(|&v| T::from_f64(v.into())).collect() };
    let (params, x) = (of(params), of(x));
    let samples = x.len() / layer.in_shape().len();
    let mut y = unwritten(samples * layer.out_shape().len());
    let mut scratch = scratch(layer, samples);
    layer.forward(&params, &x, &mut y, &mut scratch);
    let dy: Vec<_> = (0..y.len()).map(|i| small(i + 5)).collect();
    let (mut dx, mut dparams) = (vec![T::ZERO; x.len()], vec![T::ZERO; params.len()]);
    let input = with_dx.then_some(&mut dx[..]);
    layer.backward(&params, &x, &y, &of(&dy), input, &mut dparams, &mut scratch);
    [y, dx, dparams]
}

/// Whole numbers from -3 to 3 without a period that a shape has.
fn small(i: usize) -> f32 {
    ((i * i + 3 * i + i / 7) % 7) as f32 - 3.0
}

fn types(group: Group) -> Vec<(FieldType, FieldType)> {
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    vec![
        (group.trivial(6), group.regular(5)),
        (group.trivial(2), group.regular(4)),
        (group.regular(3), group.regular(9)),
        (group.regular(16), group.regular(8)),
        (group.regular(5), group.regular(37)),
        (mixed, group.regular(2)),
        (group.regular(2), mixed),
    ]
}

/// More and fewer output pixels than a pass takes at a time.
const SIZES: [[usize; 2]; 2] = [[18, 22], [6, 4]];
/// Orbits of four taps.
const EVEN: [Kernel; 2] = [Kernel::new(4, 2, 1), Kernel::new(2, 1, 0)];
/// Orbits of one and two taps as well.
const ODD: [Kernel; 2] = [Kernel::new(3, 1, 1), Kernel::new(5, 1, 2)];

fn convolutions(group: Group, kernels: &[Kernel]) -> Vec<R2Conv> {
    let mut convolutions = Vec::new();
    for (from, to) in types(group) {
        for &kernel in kernels {
            for size in SIZES {
                convolutions.push(R2Conv::new(from, to, kernel, size).unwrap());
            }
        }
    }
    convolutions
}

fn all() -> impl Iterator<Item = R2Conv> {
    let kernels = [EVEN, ODD].concat();
    let convolutions = move |group| convolutions(group, &kernels);
    Group::ALL.into_iter().flat_map(convolutions)
}

/// The layer with a ReLU, if its type has a basis that the group permutes.
fn rectified(conv: R2Conv) -> Box<dyn Layer<f32>> {
    match Relu::new(conv.out_shape()) {
        Ok(relu) => Box::new(Sequential::new(vec![Box::new(conv), Box::new(relu)]).unwrap()),
        Err(_) => Box::new(conv),
    }
}

/// Whole numbers lose nothing: every sum is exact in both precisions, so a number that is missed,
/// or added in the wrong place, shows.
#[test]
fn whole_numbers_give_the_same_bits() {
    let Some(half) = Half::available() else {
        return println!("no AMX for bfloat16: nothing to compare");
    };
    // folds of two taps, all those of D1x, D1y and C2, are scaled by the root of two
    for group in [Group::C1, Group::D2] {
        for conv in convolutions(group, &EVEN) {
            for (samples, with_dx) in [(1, true), (3, true), (3, false)] {
                let params: Vec<_> = (0..conv.num_params()).map(small).collect();
                let len = samples * conv.in_shape().len();
                let x: Vec<_> = (0..len).map(|i| small(i + 1)).collect();
                let single = run(&*rectified(conv.clone()), &params, &x, with_dx);
                let halves = run(
                    &*rectified(conv.clone().in_half(half)),
                    &params,
                    &x,
                    with_dx,
                );
                assert!(single[0].iter().any(|y| y.abs() > 5.0), "{conv}");
                assert!(single[2].iter().any(|d| d.abs() > 5.0), "{conv}");
                for (what, (single, half)) in ["y", "dx", "dparams"]
                    .iter()
                    .zip(single.iter().zip(&halves))
                {
                    assert_eq!(single, half, "{what} of {conv}, {samples} samples");
                }
            }
        }
    }
}

/// bfloat16 keeps eight bits: products are off by some 512th each, and so are sums of such. What
/// they should be is computed in double precision; a product of hundreds that is missing, or in the
/// wrong place, changes a result by several hundredths.
#[test]
fn numbers_are_off_by_their_rounding() {
    let Some(half) = Half::available() else {
        return println!("no AMX for bfloat16: nothing to compare");
    };
    for conv in all() {
        let params: Vec<f32> = params(&conv, 1);
        let len = 3 * conv.in_shape().len();
        let x: Vec<_> = (0..len).map(|i| (i as f32 * 0.37).sin()).collect();
        let exact = run::<f64>(&conv, &params, &x, true);
        let halves = run::<f32>(&conv.clone().in_half(half), &params, &x, true);
        // what they need no gradient for, first layers of D2 compute in single precision
        let (fields, group) = (conv.in_shape().fields, conv.in_shape().fields.group());
        let first = fields.is_trivial() && group == Group::D2;
        for (what, (exact, half)) in ["y", "dx", "dparams"].iter().zip(exact.iter().zip(&halves)) {
            let error = relative_error(half, exact);
            // gradients of weights are small sums of many numbers of either sign
            let bound = if *what == "dparams" { 0.03 } else { 0.005 };
            assert!(error < bound, "{what} of {conv}: {error}");
            assert!(
                error > 1e-4 || (first && *what == "y"),
                "{what} of {conv}: {error}"
            );
        }
    }
}

/// The root of the mean square of the differences over that of the numbers; not a number where one
/// of them is none.
fn relative_error(got: &[f32], exact: &[f64]) -> f64 {
    assert_eq!(got.len(), exact.len());
    let squares = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
    let differences = &mut got.iter().zip(exact).map(|(&a, b)| f64::from(a) - b);
    (squares(differences) / squares(&mut exact.iter().copied())).sqrt()
}

/// Convolutions that are fused with ReLUs, a pooling and one another.
fn chain(half: Option<Half>) -> Sequential<f32> {
    let mut layers: Vec<Box<dyn Layer<f32>>> = Vec::new();
    let mut shape = Shape::image(24, 20, Group::D2.trivial(6));
    for (fields, kernel, pooled) in [
        (5, Kernel::new(3, 1, 1), true),
        (9, Kernel::new(4, 2, 1), false),
        (16, Kernel::new(3, 1, 1), false),
    ] {
        let size = [shape.height, shape.width];
        let to = Group::D2.regular(fields);
        let conv = R2Conv::new(shape.fields, to, kernel, size).unwrap();
        shape = conv.out_shape();
        layers.push(match half {
            Some(half) => Box::new(conv.in_half(half)),
            None => Box::new(conv),
        });
        layers.push(Box::new(Relu::new(shape).unwrap()));
        if pooled {
            let pool = MaxPool::new(shape, Kernel::new(2, 2, 0)).unwrap();
            shape = pool.out_shape();
            layers.push(Box::new(pool));
        }
    }
    Sequential::new(layers).unwrap()
}

/// What a layer rounds otherwise may fall on the other side of a ReLU or a maximum behind it.
#[test]
fn fused_layers_are_off_by_their_rounding_on_any_number_of_threads() {
    let Some(half) = Half::available() else {
        return println!("no AMX for bfloat16: nothing to compare");
    };
    let (single, halves) = (chain(None), chain(Some(half)));
    let params: Vec<f32> = params(&single, 1);
    for samples in [1, 5] {
        let len = samples * single.in_shape().len();
        let x: Vec<_> = (0..len).map(|i| (i as f32 * 0.37).sin()).collect();
        let exact = run(&single, &params, &x, true).map(|v| v.into_iter().map(f64::from).collect());
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| run(&halves, &params, &x, true))
        };
        let found = on(1);
        assert_eq!(found, on(2), "{samples} samples");
        let exact: [Vec<f64>; 3] = exact;
        for (what, (exact, found)) in ["y", "dx", "dparams"].iter().zip(exact.iter().zip(&found)) {
            let error = relative_error(found, exact);
            let bound = if *what == "y" { 0.01 } else { 0.15 };
            assert!(error < bound, "{what}, {samples} samples: {error}");
        }
    }
}

#[test]
fn layers_in_half_precision_are_as_equivariant_as_others() {
    let Some(half) = Half::available() else {
        return println!("no AMX for bfloat16: nothing to compare");
    };
    for conv in all() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let params: Vec<f32> = params(&conv, 1);
        let conv = conv.in_half(half);
        let error = equivariance_error::<f32>(&conv, &params, 3, &mut rng);
        assert!(error < 1e-6, "{conv}: {error}");
    }
}

//! Sums of the outputs of units.

use equivariant::{
    FieldType, Group, Layer, LayerSignature, Linear, R2Conv, Relu, Sequential, SlidingWindow,
    absolute_activation_sums,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::common::forward;

/// Creates a chain: a convolution that halves a map of 4 x 4 pixels, one over the whole rest, their
/// ReLUs and a linear layer.
fn chain(group: Group) -> Sequential<f64> {
    let fields = |n| group.regular_type(n);
    let first =
        R2Conv::new(group.trivial_type(2), fields(3), SlidingWindow::new(4, 2, 1), [4, 4]).unwrap();
    let second = R2Conv::new(fields(3), fields(2), SlidingWindow::new(2, 1, 0), [2, 2]).unwrap();
    let [half, top] = [&first, &second].map(LayerSignature::out_shape);
    let layers: Vec<Box<dyn Layer<f64>>> = vec![
        Box::new(first),
        Box::new(Relu::new(half).unwrap()),
        Box::new(second),
        Box::new(Relu::new(top).unwrap()),
        Box::new(Linear::new(fields(2), group.trivial_type(1)).unwrap()),
    ];
    Sequential::new(layers).unwrap()
}

/// Compares with an oracle: each layer's dense kernel, applied by definition, with the regular
/// basis written out.
#[test]
fn sums_are_those_of_the_layers_run_by_hand() {
    for group in Group::ALL {
        let chain = chain(group);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut params = vec![0.0; chain.num_params()];
        chain.init(&mut rng, &mut params);
        let x: Vec<f64> = (0..2 * 4 * 4 * 2).map(|i| (0.7 * f64::from(i)).sin()).collect();
        let found = absolute_activation_sums(&chain, &params, &x);
        let layers = chain.layers();
        let first = forward(layers[0].as_ref(), &params[chain.param_range(0)], &x);
        let first = rectify(group, layers[0].out_shape().fields, &first);
        assert_eq!(found.len(), 2);
        close(&found[0], &first);
        let short = &params[..chain.param_range(2).end];
        let y = forward(layers[0].as_ref(), &short[chain.param_range(0)], &x);
        let y = forward(layers[1].as_ref(), &[], &y);
        let y = forward(layers[2].as_ref(), &short[chain.param_range(2)], &y);
        close(&found[1], &rectify(group, layers[2].out_shape().fields, &y));
    }
}

/// Returns the sums over rows of max(0, regular value), by the characters of the group.
fn rectify(group: Group, fields: FieldType, rows: &[f64]) -> Vec<f64> {
    let (order, dim) = (group.order(), fields.dim());
    let n = dim / order;
    let mut sums = vec![0.0; dim];
    for row in rows.chunks_exact(dim) {
        for (g, &element) in group.elements().iter().enumerate() {
            for f in 0..n {
                let terms = group.irreps().iter().enumerate();
                let value: f64 =
                    terms.map(|(a, irrep)| f64::from(irrep.sign(element)) * row[a * n + f]).sum();
                sums[g * n + f] += (value / (order as f64).sqrt()).max(0.0);
            }
        }
    }
    sums
}

fn close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (value, reference) in found.iter().zip(expected) {
        assert!((value - reference).abs() < 1e-12, "{value} {reference}");
    }
}

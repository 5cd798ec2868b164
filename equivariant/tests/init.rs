//! Initial weights: variances, gains, biases, determinism.

use equivariant::{FieldType, Group, Layer, LayerSignature, Linear, Relu, Sequential, Shape};

use crate::common::{boxed, conv, forward, network, normal, rng};

fn second_moment(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64
}

fn output_moment(layer: &dyn Layer<f64>, gain: f64, x: &[f64]) -> f64 {
    let mut params = vec![f64::NAN; layer.num_params()];
    layer.init_with_gain(&mut rng(1), gain, &mut params);
    second_moment(&forward(layer, &params, x))
}

/// Returns layers with about as many channels in every group.
fn wide(group: Group) -> [Box<dyn Layer<f64>>; 4] {
    let regular = |n: usize| group.regular_type(n / group.order());
    let mixed = FieldType::new(group, [40, 10, 20, 30]);
    // no padding: zeros in the window would lower the variance
    [
        conv(regular(32), regular(64), [4, 2, 0], [4, 4]),
        conv(group.trivial_type(6), regular(256), [3, 1, 0], [3, 3]),
        conv(mixed, mixed, [2, 1, 0], [3, 3]),
        boxed(Linear::new(regular(256), regular(256))),
    ]
}

#[test]
fn unit_variance_in_gives_the_gain_squared_out() {
    for group in Group::ALL {
        for layer in wide(group) {
            let x = normal(200 * layer.in_shape().len(), 2);
            for gain in [0.01, 1.0, std::f64::consts::SQRT_2] {
                let moment = output_moment(layer.as_ref(), gain, &x) / (gain * gain);
                assert!((moment - 1.0).abs() < 0.1, "{layer} of {group}: {moment}");
            }
        }
    }
}

#[test]
fn correlated_patches_of_regular_fields_keep_their_second_moment() {
    for group in Group::ALL {
        let (n_in, n_out) = (32 / group.order(), 2048 / group.order());
        let layer = conv(group.regular_type(n_in), group.regular_type(n_out), [3, 1, 0], [3, 3]);
        // one pixel, nine times: no two taps are independent
        let x = normal::<f64>(32, 5).repeat(9);
        let moment = output_moment(layer.as_ref(), 1.0, &x) / second_moment(&x);
        assert!((moment - 1.0).abs() < 0.1, "{group}: {moment}");
    }
}

#[test]
fn the_default_keeps_the_second_moment_across_relus() {
    for group in Group::ALL {
        let fields = group.regular_type(512 / group.order());
        let relu = || boxed(Relu::new(Shape::vector(fields)));
        let linear = || boxed(Linear::new(fields, fields));
        let net = Sequential::new(vec![linear(), relu(), linear(), relu(), linear(), relu()]);
        let net = net.unwrap();
        let mut params = vec![0.0; net.num_params()];
        net.init(&mut rng(3), &mut params);
        let moment = second_moment(&forward(&net, &params, &normal(50 * 512, 4)));
        assert!((moment - 1.0).abs() < 0.2, "{group}: {moment}");
    }
}

#[test]
fn biases_start_at_zero_and_equal_seeds_give_equal_weights() {
    let net = network::<f32>(Group::D2);
    let draw = |seed| {
        let mut params = vec![f32::NAN; net.num_params()];
        net.init(&mut rng(seed), &mut params);
        params
    };
    assert_eq!(draw(1), draw(1));
    assert_ne!(draw(1), draw(2));
    let first = net.param_range(0);
    assert_eq!(draw(1)[first.end - 2..first.end], [0.0, 0.0]);
    assert!(draw(1)[..first.end - 2].iter().all(|&w| w != 0.0));
}

#[test]
fn the_gain_of_a_chain_is_that_of_its_last_layer_with_parameters() {
    let net = network::<f64>(Group::D2);
    let draw = |gain| {
        let mut params = vec![0.0; net.num_params()];
        net.init_with_gain(&mut rng(1), gain, &mut params);
        params
    };
    let (small, unit) = (draw(0.01), draw(1.0));
    let head = net.param_range(6);
    assert_eq!(small[..head.start], unit[..head.start]);
    for (small_weight, unit_weight) in small[head.clone()].iter().zip(&unit[head]) {
        assert!((small_weight - 0.01 * unit_weight).abs() < 1e-12);
    }
}

#[test]
fn chains_that_do_not_fit_are_refused_with_both_shapes() {
    let linear = |a, b| -> Box<dyn Layer<f32>> {
        boxed(Linear::new(Group::D2.regular_type(a), Group::D2.regular_type(b)))
    };
    let error = Sequential::new(vec![linear(1, 2), linear(3, 1)]).unwrap_err();
    let message = error.to_string();
    assert!(
        message.contains("layer 1 takes 1 x 1 x (3 reg), but layer 0 gives 1 x 1 x (2 reg)"),
        "{message}"
    );
    let empty = Sequential::<f32>::new(vec![]).unwrap_err().to_string();
    assert!(empty.starts_with("Sequential: got the number of layers 0, expected"), "{empty}");
}

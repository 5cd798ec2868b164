//! Initial weights: variances, gains, biases, determinism.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod common;

use common::{boxed, conv, forward, network, normal, rng};
use equivariant::{Group, Layer, LayerError, Linear, Relu, Sequential};

fn second_moment(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64
}

fn output_moment(layer: &dyn Layer<f64>, gain: f64) -> f64 {
    let mut params = vec![f64::NAN; layer.num_params()];
    layer.init_scaled(&mut rng(1), gain, &mut params);
    let x = normal(200 * layer.in_shape().len(), 2);
    second_moment(&forward(layer, &params, &x))
}

#[test]
fn unit_variance_in_gives_the_gain_squared_out() {
    let regular = |n| Group::D2.regular(n);
    // no padding: zeros in the window would lower the variance
    let wide: [Box<dyn Layer<f64>>; 3] = [
        conv(regular(8), regular(16), [4, 2, 0], [4, 4]),
        conv(Group::D2.trivial(6), regular(64), [3, 1, 0], [3, 3]),
        boxed(Linear::new(regular(64), regular(64))),
    ];
    for layer in wide {
        for gain in [0.01, 1.0, std::f64::consts::SQRT_2] {
            let moment = output_moment(layer.as_ref(), gain) / (gain * gain);
            assert!((moment - 1.0).abs() < 0.1, "{} {moment}", layer.in_shape());
        }
    }
}

#[test]
fn the_default_keeps_the_second_moment_across_a_relu() {
    let linear = Linear::new(Group::D2.regular(64), Group::D2.regular(64)).unwrap();
    let relu = Relu::new(Layer::<f64>::out_shape(&linear)).unwrap();
    let net = Sequential::new(vec![
        Box::new(linear) as Box<dyn Layer<f64>>,
        Box::new(relu),
    ])
    .unwrap();
    let mut params = vec![0.0; net.num_params()];
    net.init(&mut rng(3), &mut params);
    let y = forward(&net, &params, &normal(200 * 256, 4));
    assert!((second_moment(&y) - 1.0).abs() < 0.1);
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
    let first = net.params_of(0);
    assert_eq!(draw(1)[first.end - 2..first.end], [0.0, 0.0]);
    assert!(draw(1)[..first.end - 2].iter().all(|&w| w != 0.0));
}

#[test]
fn the_gain_of_a_chain_is_that_of_its_last_layer_with_parameters() {
    let net = network::<f64>(Group::D2);
    let draw = |gain| {
        let mut params = vec![0.0; net.num_params()];
        net.init_scaled(&mut rng(1), gain, &mut params);
        params
    };
    let (small, unit) = (draw(0.01), draw(1.0));
    let head = net.params_of(6);
    assert_eq!(small[..head.start], unit[..head.start]);
    for (small, unit) in small[head.clone()].iter().zip(&unit[head]) {
        assert!((small - 0.01 * unit).abs() < 1e-12);
    }
}

#[test]
fn chains_that_do_not_fit_are_refused_with_both_shapes() {
    let linear = |a, b| -> Box<dyn Layer<f32>> {
        boxed(Linear::new(Group::D2.regular(a), Group::D2.regular(b)))
    };
    let error = Sequential::new(vec![linear(1, 2), linear(3, 1)]).unwrap_err();
    let message = error.to_string();
    assert!(
        message.contains("layer 1 takes 1 x 1 x (3 reg), but layer 0 gives 1 x 1 x (2 reg)"),
        "{message}"
    );
    assert_eq!(
        Sequential::<f32>::new(vec![]).unwrap_err(),
        LayerError::Empty
    );
}

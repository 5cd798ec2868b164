//! Poolings that run fused with the convolutions before them.

use equivariant::{Group, Layer, Scalar, Sequential};

use crate::common::{forward, largest_deviation, largest_magnitude, normal, params, pooled, run};

/// Returns output, input gradient and parameter gradient of layers that run one by one.
fn one_by_one<T: Scalar>(
    layers: &[Box<dyn Layer<T>>],
    params: &[T],
    x: &[T],
    dy: &[T],
) -> [Vec<T>; 3] {
    let mut maps = vec![x.to_vec()];
    let mut ends = vec![0];
    for layer in layers {
        let start = ends[ends.len() - 1];
        ends.push(start + layer.num_params());
        let own = &params[start..start + layer.num_params()];
        maps.push(forward(layer.as_ref(), own, &maps[maps.len() - 1]));
    }
    let (mut gradient, mut dparams) = (dy.to_vec(), vec![T::ZERO; params.len()]);
    for (i, layer) in layers.iter().enumerate().rev() {
        let own = ends[i]..ends[i + 1];
        let [_, dx, d] = run(layer.as_ref(), &params[own.clone()], &maps[i], &gradient);
        dparams[own].copy_from_slice(&d);
        gradient = dx;
    }
    [maps[layers.len()].clone(), gradient, dparams]
}

/// Checks three samples. The last has equal pixels, so windows away from the border are ties there.
fn check<T: Scalar>(group: Group, tolerance: f64) {
    let layers = pooled::<T>(group);
    let fused = Sequential::new(pooled::<T>(group)).unwrap();
    let len = layers[0].in_shape().len();
    let mut x = normal::<T>(3 * len, 1);
    x[2 * len..].fill(T::from_f64(0.5));
    let params = params(&fused as &dyn Layer<T>, 2);
    let dy = normal::<T>(3 * layers[layers.len() - 1].out_shape().len(), 3);
    let expected = one_by_one(&layers, &params, &x, &dy);
    let got = run(&fused, &params, &x, &dy);
    for (fused_values, plain_values) in got.iter().zip(&expected) {
        assert!(largest_magnitude(plain_values) > 0.1);
        let deviation = largest_deviation(fused_values, plain_values);
        assert!(deviation <= tolerance, "{group:?}: {deviation}");
    }
}

#[test]
fn not_a_number_comes_through_where_it_does_in_the_layer() {
    for group in Group::ALL {
        let layers = pooled::<f32>(group);
        let fused = Sequential::new(pooled::<f32>(group)).unwrap();
        let mut x = normal::<f32>(layers[0].in_shape().len(), 1);
        x[7] = f32::NAN;
        let params = params(&fused as &dyn Layer<f32>, 2);
        let dy = normal::<f32>(layers[layers.len() - 1].out_shape().len(), 3);
        let lost = |y: &[f32]| y.iter().map(|y| y.is_nan()).collect::<Vec<_>>();
        let expected = lost(&one_by_one(&layers, &params, &x, &dy)[0]);
        assert!(expected.contains(&true) && expected.contains(&false));
        assert_eq!(lost(&forward(&fused, &params, &x)), expected, "{group:?}");
    }
}

#[test]
fn a_fused_pooling_is_that_of_the_layer() {
    for group in Group::ALL {
        check::<f64>(group, 1e-12);
        check::<f32>(group, 1e-4);
    }
}

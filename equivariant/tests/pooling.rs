//! Poolings that run fused with the convolutions before them.

use equivariant::{Group, Layer, LayerSignature, Scalar, Sequential};

use crate::common::{forward, largest_deviation, largest_magnitude, normal, params, pooled, run};

/// Returns output, input gradient and parameter gradient of a chain's layers, which run one by one.
fn one_by_one<T: Scalar>(chain: &Sequential<T>, params: &[T], x: &[T], dy: &[T]) -> [Vec<T>; 3] {
    let mut maps = vec![x.to_vec()];
    for (i, layer) in chain.layers().iter().enumerate() {
        let own = &params[chain.param_range(i)];
        maps.push(forward(layer.as_ref(), own, &maps[i]));
    }
    let (mut gradient, mut dparams) = (dy.to_vec(), vec![T::ZERO; params.len()]);
    for (i, layer) in chain.layers().iter().enumerate().rev() {
        let own = chain.param_range(i);
        let [_, dx, d] = run(layer.as_ref(), &params[own.clone()], &maps[i], &gradient);
        dparams[own].copy_from_slice(&d);
        gradient = dx;
    }
    [maps[chain.layers().len()].clone(), gradient, dparams]
}

/// Checks three samples. The last has equal pixels, so windows away from the border are ties there.
fn check<T: Scalar>(group: Group, tolerance: f64) {
    let fused = Sequential::new(pooled::<T>(group)).unwrap();
    let len = fused.in_shape().len();
    let mut x = normal::<T>(3 * len, 1);
    x[2 * len..].fill(T::from_f64(0.5));
    let params = params(&fused as &dyn Layer<T>, 2);
    let dy = normal::<T>(3 * fused.out_shape().len(), 3);
    let expected = one_by_one(&fused, &params, &x, &dy);
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
        let fused = Sequential::new(pooled::<f32>(group)).unwrap();
        let mut x = normal::<f32>(fused.in_shape().len(), 1);
        x[7] = f32::NAN;
        let params = params(&fused as &dyn Layer<f32>, 2);
        let dy = normal::<f32>(fused.out_shape().len(), 3);
        let lost = |y: &[f32]| y.iter().map(|y| y.is_nan()).collect::<Vec<_>>();
        let expected = lost(&one_by_one(&fused, &params, &x, &dy)[0]);
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

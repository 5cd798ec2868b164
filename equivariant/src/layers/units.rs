//! What the units of a network put out.

use crate::conv::chain::Fusible;
use crate::layers::layer::Layer;
use crate::layers::scalar::Scalar;
use crate::steerable::hadamard::{permuted, transform_pixels};

/// Sums of what each unit puts out for the samples `x` `[N, H, W, C]`, a list for each ReLU of a
/// chain in its order.
///
/// A unit is a channel of a ReLU in the basis in which it is pointwise: |G| of them for a regular
/// field. Sums are over samples and places. The layers of the chain run one by one, so nothing is
/// fused and every map is allocated: this is for a look now and then.
///
/// # Panics
/// When a slice has another length than the layer's shapes say.
pub fn unit_sums<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T]) -> Vec<Vec<f64>> {
    let mut sums = Vec::new();
    walk(layer, params, x, &mut sums);
    sums
}

/// Runs a layer, or those of a chain; returns the output.
fn walk<T: Scalar>(
    layer: &dyn Layer<T>,
    params: &[T],
    x: &[T],
    sums: &mut Vec<Vec<f64>>,
) -> Vec<T> {
    if layer.layers().is_empty() {
        let y = run(layer, params, x);
        if matches!(layer.fusible(), Some(Fusible::Relu)) {
            sums.push(sums_of(layer, y.clone()));
        }
        return y;
    }
    let mut rest = params;
    layer.layers().iter().fold(x.to_vec(), |x, layer| {
        let (own, others) = rest.split_at(layer.num_params());
        rest = others;
        walk(layer.as_ref(), own, &x, sums)
    })
}

fn run<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T]) -> Vec<T> {
    let samples = x.len() / layer.in_shape().len();
    let mut y = vec![T::ZERO; samples * layer.out_shape().len()];
    layer.forward(params, x, &mut y, &mut layer.scratch(samples));
    y
}

/// The sums of each channel of maps in the basis that the group permutes.
fn sums_of<T: Scalar>(layer: &dyn Layer<T>, mut maps: Vec<T>) -> Vec<f64> {
    let fields = layer.out_shape().fields;
    if let Some((order, n)) = permuted(fields) {
        transform_pixels(order, n, &mut maps);
    }
    let mut sums = vec![0.0; fields.dim()];
    for pixel in maps.chunks_exact(fields.dim()) {
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += value.to_f64().abs();
        }
    }
    sums
}

//! Convolutions against a naive one with the expanded kernel, over random types and geometries.

use equivariant::{FieldType, Group, LayerSignature, R2Conv, SlidingWindow, hadamard_transform};
use proptest::prelude::*;

use crate::common::{forward, largest_deviation, normal, params};

/// Returns the cross-correlation of a `[C_out, C_in, k, k]` kernel with one channels-last image.
fn naive(layer: &R2Conv, kernel: &[f64], window: SlidingWindow, x: &[f64]) -> Vec<f64> {
    let (input, output) = (layer.in_shape(), layer.out_shape());
    let (c_in, c_out, k) = (input.fields.dim(), output.fields.dim(), window.size);
    let mut y = vec![0.0; output.len()];
    for (i, sum) in y.iter_mut().enumerate() {
        let (pixel, out) = (i / c_out, i % c_out);
        let (oy, ox) = (pixel / output.width, pixel % output.width);
        for (j, weight) in kernel[out * c_in * k * k..][..c_in * k * k].iter().enumerate() {
            let (c, ty, tx) = (j / (k * k), j / k % k, j % k);
            let row = (oy * window.stride + ty).wrapping_sub(window.padding);
            let col = (ox * window.stride + tx).wrapping_sub(window.padding);
            if row < input.height && col < input.width {
                *sum += weight * x[(row * input.width + col) * c_in + c];
            }
        }
    }
    y
}

fn with_zero_bias(layer: &R2Conv, seed: u64) -> Vec<f64> {
    let mut params = params::<f64>(layer, seed);
    let trivial = layer.out_shape().fields.channel_range(symmetry::Irrep::Trivial).len();
    let weights = params.len() - trivial;
    params[weights..].fill(0.0);
    params
}

fn multiplicities() -> impl Strategy<Value = [usize; 4]> {
    proptest::array::uniform4(prop_oneof![3 => 0usize..4, 1 => 4usize..24])
        .prop_filter("at least one channel", |m| m.iter().sum::<usize>() > 0)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_convolution_is_that_of_its_expanded_kernel(
        group in proptest::sample::select(&Group::ALL),
        in_multiplicities in multiplicities(),
        out_multiplicities in multiplicities(),
        size in 1usize..6,
        stride in 1usize..4,
        padding in 0usize..3,
        height in 1usize..9,
        width in 1usize..9,
        seed in 0u64..1000,
    ) {
        let window = SlidingWindow::new(size, stride, padding);
        let in_type = FieldType::new(group, in_multiplicities);
        let out_type = FieldType::new(group, out_multiplicities);
        let layer = R2Conv::new(in_type, out_type, window, [height, width]);
        let extents = [
            (height, group.has_element_flipping_y()),
            (width, group.has_element_flipping_x()),
        ];
        let exact = extents.map(|(n, flipped)| {
            n + 2 * padding >= size && (!flipped || (n + 2 * padding - size) % stride == 0)
        });
        prop_assert_eq!(layer.is_ok(), exact == [true, true]);
        let Ok(layer) = layer else { return Ok(()) };
        let params = with_zero_bias(&layer, seed);
        let kernel = layer.as_ordinary_conv().kernel(&params);
        let len = layer.in_shape().len();
        // five samples, so that groups of two to four that are converted together leave one
        // incomplete
        let x = normal::<f64>(5 * len, seed + 1);
        let y = forward(&layer, &params, &x);
        let expected: Vec<f64> = x.chunks(len).flat_map(|x| naive(&layer, &kernel, window, x)).collect();
        prop_assert!(largest_deviation(&y, &expected) < 1e-11);
    }
}

#[test]
fn the_regular_kernel_does_the_same_in_the_regular_basis() {
    let window = SlidingWindow::new(4, 2, 1);
    let types = [2, 3].map(|n| Group::D2.regular_type(n));
    let layer = R2Conv::new(types[0], types[1], window, [6, 4]).unwrap();
    let params = with_zero_bias(&layer, 7);
    let x = normal::<f64>(layer.in_shape().len(), 8);
    let mut expected = forward(&layer, &params, &x);
    expected.chunks_mut(12).for_each(|pixel| hadamard_transform(Group::D2, pixel));
    let mut regular_x = x;
    regular_x.chunks_mut(8).for_each(|pixel| hadamard_transform(Group::D2, pixel));
    let kernel = layer.as_ordinary_conv().regular_basis_kernel(&params);
    let y = naive(&layer, &kernel, window, &regular_x);
    assert!(largest_deviation(&y, &expected) < 1e-12);
}

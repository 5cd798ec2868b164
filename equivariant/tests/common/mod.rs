//! The layers that every property is tested on.

#![allow(dead_code, reason = "every test file uses a part of it")]
#![allow(clippy::unwrap_used, reason = "a helper of tests")]

use equivariant::{
    FieldType, GroupMaxPool, Kernel, Layer, Linear, R2Conv, Relu, Scalar, Sequential, Shape,
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Every kind of layer, with even, odd, strided and 1 x 1 kernels, mixed and lacking irreps.
pub fn layers<T: Scalar>() -> Vec<(&'static str, Box<dyn Layer<T>>)> {
    let regular = FieldType::regular;
    let mixed = FieldType::new([2, 1, 3, 0]);
    vec![
        (
            "4x4/2",
            conv(FieldType::trivial(6), regular(4), [4, 2, 1], [6, 8]),
        ),
        ("3x3", conv(regular(2), regular(3), [3, 1, 0], [3, 3])),
        (
            "3x3/2",
            conv(mixed, FieldType::new([1, 2, 0, 2]), [3, 2, 1], [5, 7]),
        ),
        ("5x5", conv(regular(1), mixed, [5, 1, 2], [4, 3])),
        ("2x2", conv(regular(8), regular(2), [2, 2, 0], [4, 6])),
        ("1x1", conv(mixed, mixed, [1, 1, 0], [2, 3])),
        (
            "linear",
            Box::new(Linear::new(regular(3), FieldType::new([2, 1, 1, 0]))),
        ),
        (
            "linear from mixed",
            Box::new(Linear::new(mixed, regular(4))),
        ),
        (
            "relu",
            Box::new(Relu::new(Shape::image(3, 2, regular(3))).unwrap()),
        ),
        (
            "relu of 8",
            Box::new(Relu::new(Shape::image(3, 2, regular(8))).unwrap()),
        ),
        (
            "trivial relu",
            Box::new(Relu::new(Shape::vector(FieldType::trivial(5))).unwrap()),
        ),
        (
            "pool",
            Box::new(GroupMaxPool::new(Shape::image(2, 3, regular(4))).unwrap()),
        ),
        ("sequential", Box::new(network())),
        ("nested", Box::new(nested())),
    ]
}

pub fn conv<T: Scalar>(
    in_type: FieldType,
    out_type: FieldType,
    [size, stride, padding]: [usize; 3],
    image: [usize; 2],
) -> Box<dyn Layer<T>> {
    let kernel = Kernel {
        size,
        stride,
        padding,
    };
    Box::new(R2Conv::new(in_type, out_type, kernel, image).unwrap())
}

/// A small encoder: images to vectors.
pub fn network<T: Scalar>() -> Sequential<T> {
    let regular = FieldType::regular;
    let relu = |size, n| -> Box<dyn Layer<T>> {
        Box::new(Relu::new(Shape::image(size, size, FieldType::regular(n))).unwrap())
    };
    let layers = vec![
        conv(FieldType::trivial(3), regular(2), [4, 2, 1], [8, 8]),
        relu(4, 2),
        conv(regular(2), regular(4), [4, 2, 1], [4, 4]),
        relu(2, 4),
        conv(regular(4), regular(8), [2, 1, 0], [2, 2]),
        relu(1, 8),
        Box::new(Linear::new(regular(8), FieldType::new([2, 1, 1, 0]))),
    ];
    Sequential::new(layers).unwrap()
}

/// A chain whose layers are chains.
fn nested<T: Scalar>() -> Sequential<T> {
    let hidden = FieldType::new([2, 1, 1, 0]);
    let head: Vec<Box<dyn Layer<T>>> = vec![
        Box::new(Linear::new(hidden, FieldType::regular(3))),
        Box::new(Relu::new(Shape::vector(FieldType::regular(3))).unwrap()),
        Box::new(Linear::new(FieldType::regular(3), hidden)),
    ];
    Sequential::new(vec![
        Box::new(network::<T>()) as Box<dyn Layer<T>>,
        Box::new(Sequential::new(head).unwrap()),
    ])
    .unwrap()
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Normal numbers of unit variance, from the library's own initialisation.
pub fn normal<T: Scalar>(len: usize, seed: u64) -> Vec<T> {
    let rows = len.max(1);
    let source = Linear::new(FieldType::trivial(1), FieldType::trivial(rows));
    let mut values = vec![T::ZERO; 2 * rows];
    source.init_scaled(&mut rng(seed), 1.0, &mut values);
    values.truncate(len);
    values
}

/// Parameters with biases that are not zero.
pub fn params<T: Scalar>(layer: &dyn Layer<T>, seed: u64) -> Vec<T> {
    let scale = T::from_f64(0.4);
    normal(layer.num_params(), seed)
        .into_iter()
        .map(|p: T| p * scale)
        .collect()
}

pub fn forward<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T]) -> Vec<T> {
    let samples = x.len() / layer.in_shape().len();
    let mut y = vec![T::ZERO; samples * layer.out_shape().len()];
    // garbage on entry: layers must not read what they did not write
    let mut scratch = vec![T::from_f64(f64::NAN); layer.scratch_len(samples)];
    layer.forward(params, x, &mut y, &mut scratch);
    y
}

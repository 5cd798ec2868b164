//! The layers that every property is tested on.

#![allow(dead_code, reason = "every test file uses a part of it")]
#![allow(clippy::unwrap_used, reason = "a helper of tests")]

use equivariant::{
    FieldType, Group, GroupMaxPool, Kernel, Layer, Linear, R2Conv, Relu, Scalar, Sequential, Shape,
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Every kind of layer for every group, by name.
pub fn layers<T: Scalar>() -> Vec<(String, Box<dyn Layer<T>>)> {
    let named = |group: Group| {
        let layers = layers_of(group).into_iter();
        layers.map(move |(name, layer)| (format!("{name} of {group}"), layer))
    };
    Group::ALL.into_iter().flat_map(named).collect()
}

/// Every kind of layer, with even, odd, strided and 1 x 1 kernels, mixed and lacking irreps.
pub fn layers_of<T: Scalar>(group: Group) -> Vec<(&'static str, Box<dyn Layer<T>>)> {
    let regular = |n| group.regular(n);
    let mixed = FieldType::new(group, [2, 1, 3, 0]);
    let lacking = FieldType::new(group, [1, 2, 0, 2]);
    vec![
        (
            "4x4/2",
            conv(group.trivial(6), regular(4), [4, 2, 1], [6, 8]),
        ),
        ("3x3", conv(regular(2), regular(3), [3, 1, 0], [3, 3])),
        ("3x3/2", conv(mixed, lacking, [3, 2, 1], [5, 7])),
        ("5x5", conv(regular(1), mixed, [5, 1, 2], [4, 3])),
        ("2x2", conv(regular(8), regular(2), [2, 2, 0], [4, 6])),
        ("1x1", conv(mixed, mixed, [1, 1, 0], [2, 3])),
        ("linear", boxed(Linear::new(regular(3), lacking))),
        ("linear from mixed", boxed(Linear::new(mixed, regular(4)))),
        ("relu", boxed(Relu::new(Shape::image(3, 2, regular(3))))),
        (
            "relu of 8",
            boxed(Relu::new(Shape::image(3, 2, regular(8)))),
        ),
        (
            "trivial relu",
            boxed(Relu::new(Shape::vector(group.trivial(5)))),
        ),
        (
            "group max-pool",
            boxed(GroupMaxPool::new(Shape::image(2, 3, regular(4)))),
        ),
        ("sequential", Box::new(network(group))),
        ("nested", Box::new(nested(group))),
    ]
}

pub fn boxed<T: Scalar, L: Layer<T> + 'static>(
    layer: Result<L, equivariant::LayerError>,
) -> Box<dyn Layer<T>> {
    Box::new(layer.unwrap())
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
    boxed(R2Conv::new(in_type, out_type, kernel, image))
}

/// A small encoder: images to vectors.
pub fn network<T: Scalar>(group: Group) -> Sequential<T> {
    let regular = |n| group.regular(n);
    let relu = |size, n| boxed(Relu::new(Shape::image(size, size, regular(n))));
    let layers = vec![
        conv(group.trivial(3), regular(2), [4, 2, 1], [8, 8]),
        relu(4, 2),
        conv(regular(2), regular(4), [4, 2, 1], [4, 4]),
        relu(2, 4),
        conv(regular(4), regular(8), [2, 1, 0], [2, 2]),
        relu(1, 8),
        boxed(Linear::new(regular(8), hidden(group))),
    ];
    Sequential::new(layers).unwrap()
}

fn hidden(group: Group) -> FieldType {
    FieldType::new(group, [2, 1, 1, 0])
}

/// A chain whose layers are chains.
fn nested<T: Scalar>(group: Group) -> Sequential<T> {
    let regular = group.regular(3);
    let head = vec![
        boxed(Linear::new(hidden(group), regular)),
        boxed(Relu::new(Shape::vector(regular))),
        boxed(Linear::new(regular, hidden(group))),
    ];
    Sequential::new(vec![
        boxed(Ok(network::<T>(group))),
        boxed(Sequential::new(head)),
    ])
    .unwrap()
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Normal numbers of unit variance, from the library's own initialisation.
pub fn normal<T: Scalar>(len: usize, seed: u64) -> Vec<T> {
    let rows = len.max(1);
    let source = Linear::new(Group::D2.trivial(1), Group::D2.trivial(rows)).unwrap();
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

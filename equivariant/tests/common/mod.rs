//! Layers on which every property is tested, and helpers.

#![allow(dead_code, reason = "every test file uses a part of it")]
#![allow(clippy::unwrap_used, reason = "a helper of tests")]

use std::panic::{AssertUnwindSafe, catch_unwind};

use equivariant::{
    Concat, FieldType, Group, Layer, LayerError, Linear, MaxPool, R2Conv, Relu, Scalar, Scratch,
    Sequential, Shape, SlidingWindow, test_layers,
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use safetensors::SafeTensors;

/// Returns every example of the registry and chains of layers, for every group, by name.
pub fn layers<T: Scalar>() -> Vec<(String, Box<dyn Layer<T>>)> {
    let named = |group: Group| {
        let layers = layers_of(group).into_iter();
        layers.map(move |(name, layer)| (format!("{name} of {group}"), layer))
    };
    Group::ALL.into_iter().flat_map(named).collect()
}

/// Returns examples and chains of one group.
pub fn layers_of<T: Scalar>(group: Group) -> Vec<(&'static str, Box<dyn Layer<T>>)> {
    let single = test_layers(group).unwrap().into_iter();
    let mut layers: Vec<_> = single.map(|of| (of.name, of.layer)).collect();
    layers.push(("sequential", Box::new(network(group))));
    layers.push(("nested", Box::new(nested(group))));
    layers.push(("pooled", boxed(Sequential::new(pooled(group)))));
    layers
}

/// Creates the sum of a map that lacks irreps and one of regular fields.
pub fn concat(group: Group) -> Concat {
    let lacking = Shape::image(2, 3, FieldType::new(group, [1, 2, 0, 1]));
    Concat::new(lacking, Shape::image(2, 3, group.regular_type(2))).unwrap()
}

pub fn kernel([size, stride, padding]: [usize; 3]) -> SlidingWindow {
    SlidingWindow::new(size, stride, padding)
}

pub fn boxed<T: Scalar, L: Layer<T> + 'static>(layer: Result<L, LayerError>) -> Box<dyn Layer<T>> {
    Box::new(layer.unwrap())
}

pub fn conv<T: Scalar>(
    in_type: FieldType,
    out_type: FieldType,
    window: [usize; 3],
    image: [usize; 2],
) -> Box<dyn Layer<T>> {
    boxed(R2Conv::new(in_type, out_type, kernel(window), image))
}

/// Creates a small encoder: images to vectors.
pub fn network<T: Scalar>(group: Group) -> Sequential<T> {
    let regular = |n| group.regular_type(n);
    let relu = |size, n| boxed(Relu::new(Shape::image(size, size, regular(n))));
    let layers = vec![
        conv(group.trivial_type(3), regular(2), [4, 2, 1], [8, 8]),
        relu(4, 2),
        conv(regular(2), regular(4), [4, 2, 1], [4, 4]),
        relu(2, 4),
        conv(regular(4), regular(8), [2, 1, 0], [2, 2]),
        relu(1, 8),
        boxed(Linear::new(regular(8), hidden(group))),
    ];
    Sequential::new(layers).unwrap()
}

/// Returns convolutions followed by poolings, over the largest windows that run fused, over three
/// pixels and over one: of a rectified map, of one that is not, and one that ends a chain.
pub fn pooled<T: Scalar>(group: Group) -> Vec<Box<dyn Layer<T>>> {
    let regular = |n| group.regular_type(n);
    let image = Shape::image;
    let pool = |shape, size| boxed(MaxPool::new(shape, kernel([size, size, 0])));
    vec![
        conv(group.trivial_type(3), regular(3), [3, 1, 1], [12, 24]),
        boxed(Relu::new(image(12, 24, regular(3)))),
        pool(image(12, 24, regular(3)), 4),
        conv(regular(3), regular(8), [3, 1, 1], [3, 6]),
        pool(image(3, 6, regular(8)), 3),
        conv(regular(8), regular(5), [1, 1, 0], [1, 2]),
        boxed(Relu::new(image(1, 2, regular(5)))),
        pool(image(1, 2, regular(5)), 1),
    ]
}

fn hidden(group: Group) -> FieldType {
    FieldType::new(group, [2, 1, 1, 0])
}

/// Creates a chain whose layers are chains.
fn nested<T: Scalar>(group: Group) -> Sequential<T> {
    let regular = group.regular_type(3);
    let head = vec![
        boxed(Linear::new(hidden(group), regular)),
        boxed(Relu::new(Shape::vector(regular))),
        boxed(Linear::new(regular, hidden(group))),
    ];
    Sequential::new(vec![boxed(Ok(network::<T>(group))), boxed(Sequential::new(head))]).unwrap()
}

/// Returns a tensor of double precision in a safetensors file.
pub fn golden(file: &[u8], name: &str) -> Vec<f64> {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let (values, _) = tensors.tensor(name).unwrap().data().as_chunks();
    values.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()
}

/// Returns the message of the panic of a call, if it panics.
pub fn panic_of(call: impl FnOnce()) -> Option<String> {
    let panic = catch_unwind(AssertUnwindSafe(call)).err()?;
    Some(panic.downcast_ref::<String>().unwrap().clone())
}

pub fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Draws normal numbers of unit variance, from the library's own initialisation.
pub fn normal<T: Scalar>(len: usize, seed: u64) -> Vec<T> {
    let rows = len.max(1);
    let source = Linear::new(Group::D2.trivial_type(1), Group::D2.trivial_type(rows)).unwrap();
    let mut values = vec![T::ZERO; 2 * rows];
    source.init_with_gain(&mut rng(seed), 1.0, &mut values);
    values.truncate(len);
    values
}

/// Draws parameters with non-zero biases.
pub fn params<T: Scalar>(layer: &dyn Layer<T>, seed: u64) -> Vec<T> {
    let scale = T::from_f64(0.4);
    normal(layer.num_params(), seed).into_iter().map(|p: T| p * scale).collect()
}

/// Creates memory for the passes, full of NaN: layers must not read what they did not write.
pub fn scratch<T: Scalar>(layer: &(impl Layer<T> + ?Sized), samples: usize) -> Scratch<T> {
    Scratch::new_filled(layer.scratch_len(samples), T::from_f64(f64::NAN))
}

/// Creates an output of NaN: layers must write all of it and add to none.
pub fn unwritten<T: Scalar>(len: usize) -> Vec<T> {
    vec![T::from_f64(f64::NAN); len]
}

/// Returns the largest absolute difference between two slices of equal length; NaN if a value or a
/// difference is NaN, so that every comparison with a tolerance fails.
pub fn largest_deviation<T: Scalar>(got: &[T], expected: &[T]) -> f64 {
    assert_eq!(got.len(), expected.len(), "lengths differ");
    let pairs = got.iter().zip(expected);
    largest(pairs.map(|(a, b)| (a.to_f64() - b.to_f64()).abs()))
}

/// Returns the largest difference over the largest expected magnitude; NaN if a value is NaN.
pub fn relative_deviation<T: Scalar>(got: &[T], expected: &[T]) -> f64 {
    largest_deviation(got, expected) / largest_magnitude(expected)
}

#[test]
fn comparisons_see_one_wrong_value() {
    let right = [1.0, 2.0, 3.0];
    assert_eq!(relative_deviation(&right, &right), 0.0);
    for i in 0..3 {
        for wrong in [f64::NAN, f64::INFINITY, 3.1] {
            let mut got = right;
            got[i] = wrong;
            let passes = relative_deviation(&got, &right) < 1e-2;
            assert!(!passes, "{wrong}");
        }
    }
}

/// Returns the largest magnitude; NaN if one is NaN.
pub fn largest_magnitude<T: Scalar>(values: &[T]) -> f64 {
    largest(values.iter().map(|v| v.to_f64().abs()))
}

/// Returns the largest of some numbers of at least zero; NaN if one is NaN, which `f64::max` drops.
pub fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |m, v| if v > m || v.is_nan() { v } else { m })
}

/// Returns the output and the gradients of input and parameters, of both passes.
pub fn run<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T], dy: &[T]) -> [Vec<T>; 3] {
    let mut scratch = scratch(layer, x.len() / layer.in_shape().len());
    let (mut y, mut dx) = (unwritten(dy.len()), unwritten(x.len()));
    layer.forward(params, x, &mut y, &mut scratch);
    // starts at one, not zero, since gradients must be added
    let mut dparams = vec![T::from_f64(1.0); params.len()];
    layer.backward(params, x, &y, dy, Some(&mut dx), &mut dparams, &mut scratch);
    dparams.iter_mut().for_each(|d| *d -= T::from_f64(1.0));
    [y, dx, dparams]
}

pub fn forward<T: Scalar>(layer: &dyn Layer<T>, params: &[T], x: &[T]) -> Vec<T> {
    let samples = x.len() / layer.in_shape().len();
    let mut y = unwritten(samples * layer.out_shape().len());
    layer.forward(params, x, &mut y, &mut scratch(layer, samples));
    y
}

//! Writes a network and samples of it for `benches/peers/interchange.py`: export DIR.
//!
//! It contains every kind of layer that other libraries have: the reference encoder, followed by a
//! pooled one.

use std::error::Error;
use std::path::Path;

use equivariant::{
    FieldType, Group, GroupMaxPool, Layer, LayerError, LayerSignature, Linear, MaxPool, R2Conv,
    Relu, Sequential, Shape, SlidingWindow, save_safetensors,
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use safetensors::{Dtype, tensor::TensorView};

const SAMPLES: usize = 8;
const HALVING: SlidingWindow = SlidingWindow::new(4, 2, 1);
const SAME: SlidingWindow = SlidingWindow::new(3, 1, 1);
const POOL: SlidingWindow = SlidingWindow::new(2, 2, 0);

type Layers = Vec<Box<dyn Layer<f32>>>;

fn conv(
    layers: &mut Layers,
    shape: Shape,
    n: usize,
    kernel: SlidingWindow,
) -> Result<Shape, LayerError> {
    let fields = shape.fields.group().regular_type(n);
    let size = [shape.height, shape.width];
    let conv = R2Conv::new(shape.fields, fields, kernel, size)?;
    let out_shape = conv.out_shape();
    layers.push(Box::new(conv));
    layers.push(Box::new(Relu::new(out_shape)?));
    Ok(out_shape)
}

/// Creates the network 64 x 64 x 6 -> 8, 16, 32, 32 fields by strided convolutions -> 16 fields,
/// pooled to one pixel -> 5 numbers.
fn network(group: Group) -> Result<Sequential<f32>, LayerError> {
    let mut layers = Layers::new();
    let mut shape = Shape::image(64, 64, group.trivial_type(6));
    for n in [8, 16, 32, 32] {
        shape = conv(&mut layers, shape, n, HALVING)?;
    }
    shape = conv(&mut layers, shape, 16, SAME)?;
    let first_pool = MaxPool::new(shape, POOL)?;
    let second_pool = MaxPool::new(first_pool.out_shape(), POOL)?;
    let group_max = GroupMaxPool::new(second_pool.out_shape())?;
    let pooled = group_max.out_shape();
    let head = Linear::new(pooled.fields, FieldType::new(group, [5, 0, 0, 0]))?;
    layers.extend([
        Box::new(first_pool) as Box<dyn Layer<f32>>,
        Box::new(second_pool),
        Box::new(group_max),
        Box::new(head),
    ]);
    Sequential::new(layers)
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn export(dir: &Path, group: Group) -> Result<(), Box<dyn Error>> {
    let net = network(group)?;
    let mut params = vec![0.0; net.num_params()];
    net.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
    save_safetensors(dir.join(format!("{group}.safetensors")), &net, &params)?;
    let x: Vec<f32> =
        (0..SAMPLES * net.in_shape().len()).map(|i| (i as f32 * 0.37).sin()).collect();
    let mut y = vec![0.0; SAMPLES * net.out_shape().len()];
    let mut scratch = net.allocate_scratch(SAMPLES);
    net.forward(&params, &x, &mut y, &mut scratch);
    let (x, y) = (bytes(&x), bytes(&y));
    let tensors = [
        ("x", TensorView::new(Dtype::F32, vec![SAMPLES, 64, 64, 6], &x)?),
        ("y", TensorView::new(Dtype::F32, vec![SAMPLES, 1, 1, 5], &y)?),
    ];
    let file = safetensors::serialize(tensors, None)?;
    std::fs::write(dir.join(format!("{group}-samples.safetensors")), file)?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let dir = std::env::args().nth(1).ok_or("usage: export DIR")?;
    std::fs::create_dir_all(&dir)?;
    for group in Group::ALL {
        export(Path::new(&dir), group)?;
    }
    Ok(())
}

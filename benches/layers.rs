//! Benchmarks of forward and backward passes of the encoder that experiments use, per sample.
//!
//! `48 x 48 x 6 -> 4, 8, 16, 16 regular fields (4 x 4, stride 2, padding 1) -> 32 fields (3 x 3)`,
//! every convolution followed by a ReLU, then group pooling; f32, one thread, chunks of 16 samples.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use equivariant::{
    Group, GroupMaxPool, Layer, LayerError, LayerSignature, R2Conv, Relu, Scratch, Sequential,
    SlidingWindow,
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const SAMPLES: usize = 16;

fn encoder() -> Result<Sequential<f32>, LayerError> {
    let halve = SlidingWindow::new(4, 2, 1);
    let last = SlidingWindow::new(3, 1, 0);
    let mut layers: Vec<Box<dyn Layer<f32>>> = Vec::new();
    let (mut fields, mut size) = (Group::D2.trivial_type(6), 48);
    for (n, kernel) in [(4, halve), (8, halve), (16, halve), (16, halve), (32, last)] {
        let conv = R2Conv::new(fields, Group::D2.regular_type(n), kernel, [size; 2])?;
        let shape = conv.out_shape();
        (fields, size) = (shape.fields, shape.height);
        layers.push(Box::new(conv));
        layers.push(Box::new(Relu::new(shape)?));
    }
    layers.push(Box::new(GroupMaxPool::new(layers[9].out_shape())?));
    Sequential::new(layers)
}

struct Batch {
    params: Vec<f32>,
    gradient: Vec<f32>,
    x: Vec<f32>,
    y: Vec<f32>,
    dy: Vec<f32>,
    dx: Vec<f32>,
    scratch: Scratch<f32>,
}

impl Batch {
    fn new(layer: &dyn Layer<f32>) -> Batch {
        let mut params = vec![0.0; layer.num_params()];
        layer.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
        let (in_len, out_len) = (layer.in_shape().len(), layer.out_shape().len());
        let x: Vec<f32> =
            (0..SAMPLES * in_len).map(|i| (i * 37 % 101) as f32 / 50.0 - 1.0).collect();
        Batch {
            gradient: vec![0.0; params.len()],
            params,
            dx: vec![0.0; x.len()],
            x,
            y: vec![0.0; SAMPLES * out_len],
            dy: vec![1.0; SAMPLES * out_len],
            scratch: layer.allocate_scratch(SAMPLES),
        }
    }

    fn forward(&mut self, layer: &dyn Layer<f32>) {
        layer.forward(&self.params, &self.x, &mut self.y, &mut self.scratch);
    }

    fn backward(&mut self, layer: &dyn Layer<f32>, with_dx: bool) {
        let dx = with_dx.then_some(&mut self.dx[..]);
        let (x, y, dy) = (&self.x, &self.y, &self.dy);
        let gradient = &mut self.gradient;
        layer.backward(&self.params, x, y, dy, dx, gradient, &mut self.scratch);
    }
}

fn bench(c: &mut Criterion, name: &str, layer: &dyn Layer<f32>, with_dx: bool) {
    let mut batch = Batch::new(layer);
    batch.forward(layer);
    batch.backward(layer, with_dx);
    assert!(batch.y.iter().all(|y| y.is_finite()));
    assert!(batch.gradient.iter().any(|&g| g != 0.0) || batch.gradient.is_empty());
    let mut group = c.benchmark_group(name);
    group.throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function("forward", |b| {
        b.iter(|| batch.forward(black_box(layer)));
    });
    group.bench_function("forward_backward", |b| {
        b.iter(|| {
            batch.forward(black_box(layer));
            batch.backward(layer, with_dx);
        });
    });
    group.finish();
}

fn layers(c: &mut Criterion) {
    let encoder = match encoder() {
        Ok(encoder) => encoder,
        Err(error) => panic!("the encoder is refused: {error}"),
    };
    bench(c, "encoder_48x48x6_f32", &encoder, false);
    for (i, layer) in encoder.layers().iter().enumerate() {
        let name = format!("encoder_layer_{i}_f32");
        bench(c, &name, layer.as_ref(), i > 0);
    }
}

criterion_group!(benches, layers);
criterion_main!(benches);

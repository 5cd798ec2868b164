//! Trains a classifier with the `equivariant` crate in a custom training loop: `cargo run --release
//! --example embed_equivariant`.
//!
//! Images show a randomly flipped glyph near the middle of noise; the class is the glyph, so the
//! classifier should be invariant under flips. The same code trains a D2-invariant network and an
//! ordinary one (C1) with as many channels on few images, and prints the accuracy of each on new
//! ones.

use equivariant::{
    Group, GroupMaxPool, Layer, LayerError, LayerSignature, Linear, ParallelChunks, R2Conv, Relu,
    Sequential, Shape, SlidingWindow,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

const SIDE: usize = 16;
const PIXELS: usize = SIDE * SIDE;
const GLYPH: usize = 8;
const MIDDLE: usize = (SIDE - GLYPH) / 2;
const CLASSES: usize = 4;
const CHUNK: usize = 16;

/// Builds a network of two halving convolutions and a flattening one, each with a ReLU, a group
/// pooling and a linear layer for the class scores.
fn network(group: Group) -> Result<Sequential<f32>, LayerError> {
    let halving = SlidingWindow::new(4, 2, 1);
    let mut layers: Vec<Box<dyn Layer<f32>>> = Vec::new();
    let mut shape = Shape::image(SIDE, SIDE, group.trivial_type(1));
    for channels in [16, 32, 64] {
        let fields = group.regular_type(channels / group.order());
        let conv = match shape.height {
            4 => R2Conv::flattening(shape, fields)?,
            size => R2Conv::new(shape.fields, fields, halving, [size; 2])?,
        };
        shape = conv.out_shape();
        layers.push(Box::new(conv));
        layers.push(Box::new(Relu::new(shape)?));
    }
    let pool = GroupMaxPool::new(shape)?;
    let invariants = pool.out_shape().fields;
    layers.push(Box::new(pool));
    layers.push(Box::new(Linear::new(invariants, group.trivial_type(CLASSES))?));
    Sequential::new(layers)
}

/// Trains by gradient descent with momentum on the cross-entropy of all images.
fn train(net: &Sequential<f32>, data: &Data, steps: usize) -> Vec<f32> {
    let mut params = vec![0.0; net.num_params()];
    net.init(&mut ChaCha8Rng::seed_from_u64(1), &mut params);
    let mut velocity = vec![0.0; params.len()];
    let (samples, scratch) = (data.labels.len(), net.allocate_scratch(CHUNK));
    let buffers = move || (vec![0.0; CHUNK * CLASSES], scratch.clone());
    let mut chunks = ParallelChunks::new(params.len(), CHUNK, buffers);
    for _ in 0..steps {
        velocity.iter_mut().for_each(|v| *v *= 0.9);
        chunks.accumulate_gradients(samples, &mut velocity, |range, (y, own_scratch), gradient| {
            let x = &data.pictures[range.start * PIXELS..range.end * PIXELS];
            let y = &mut y[..range.len() * CLASSES];
            net.forward(&params, x, y, own_scratch);
            let dy = cross_entropy(y, &data.labels[range]);
            net.backward(&params, x, y, &dy, None, gradient, own_scratch);
        });
        for (p, v) in params.iter_mut().zip(&velocity) {
            *p -= 0.05 / samples as f32 * v;
        }
    }
    params
}

/// Returns the gradient of the cross-entropy with respect to the scores: probabilities minus the
/// one-hot label.
fn cross_entropy(scores: &[f32], labels: &[usize]) -> Vec<f32> {
    let mut gradient = scores.to_vec();
    for (row, &label) in gradient.chunks_mut(CLASSES).zip(labels) {
        let largest = row.iter().fold(f32::MIN, |m, &s| m.max(s));
        row.iter_mut().for_each(|s| *s = (*s - largest).exp());
        let sum: f32 = row.iter().sum();
        row.iter_mut().for_each(|s| *s /= sum);
        row[label] -= 1.0;
    }
    gradient
}

/// Returns the share of images whose largest score is the label's, in `[0, 1]`.
fn accuracy(net: &Sequential<f32>, params: &[f32], data: &Data) -> f64 {
    let mut scratch = net.allocate_scratch(1);
    let mut scores = [0.0; CLASSES];
    let samples = data.pictures.chunks(PIXELS).zip(&data.labels);
    let right = samples.filter(|(x, label)| {
        net.forward(params, x, &mut scores, &mut scratch);
        scores.iter().all(|&s| s <= scores[**label])
    });
    right.count() as f64 / data.labels.len() as f64
}

struct Data {
    pictures: Vec<f32>,
    labels: Vec<usize>,
}

/// Draws images of randomly flipped and shifted glyphs in noise.
fn pictures(glyphs: &[Vec<f32>], count: usize, rng: &mut ChaCha8Rng) -> Data {
    let mut data = Data { pictures: Vec::new(), labels: Vec::new() };
    for _ in 0..count {
        let label = rng.random_range(0..CLASSES);
        let flip = D2::from_bits(rng.random_range(0..4));
        let glyph = flip.transform_image(&glyphs[label], GLYPH, GLYPH, 1);
        let mut picture: Vec<f32> = noise(PIXELS, rng).map(|v| 0.5 * v).collect();
        let [top, left] = [0; 2].map(|_: usize| rng.random_range(MIDDLE - 1..=MIDDLE + 1));
        for (i, value) in glyph.iter().enumerate() {
            picture[(top + i / GLYPH) * SIDE + left + i % GLYPH] += value;
        }
        data.pictures.extend(picture);
        data.labels.push(label);
    }
    data
}

/// Draws uniform numbers with mean 0 and variance 1.
fn noise(len: usize, rng: &mut impl Rng) -> impl Iterator<Item = f32> {
    let width = 12f32.sqrt();
    (0..len).map(move |_| (rng.random::<f32>() - 0.5) * width)
}

fn main() -> Result<(), LayerError> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let glyphs: Vec<Vec<f32>> =
        (0..CLASSES).map(|_| noise(GLYPH * GLYPH, &mut rng).collect()).collect();
    let (few, new) = (pictures(&glyphs, 200, &mut rng), pictures(&glyphs, 1000, &mut rng));
    for group in [Group::D2, Group::C1] {
        let net = network(group)?;
        let params = train(&net, &few, 60);
        println!(
            "{group}: {} parameters, accuracy {:.3}",
            params.len(),
            accuracy(&net, &params, &new)
        );
    }
    Ok(())
}

//! Compares the products of a network's convolutions in faer with whole passes of the network:
//! medians of alternating measurements in ms, for 64 images of 64 x 64 x 6 on one thread.
//!
//! `cargo run --release -p covers-benches --example product_times`
//!
//! A convolution is four products, one for each irrep: folded patches times weights. A training
//! step has two more of each, for the gradients in the weights and, but for the first layer, in the
//! patches. The factors are prepared, column by column, for 8 images at a time: nothing is
//! gathered, folded or scattered, and all chunks of images have the same factors.

mod networks;

use std::time::Instant;

use equivariant::{Layer, LayerError, LayerSignature, Scratch, Sequential};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use networks::{HALVING_CONV_WINDOW, IMAGE_CHANNELS, build_d2_conv_network};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const IMAGES: usize = 64;
/// Number of images that are computed together, by the network and in faer alone.
const CHUNK: usize = 8;
const SIZE: usize = 64;
const NETWORKS: [(&str, [usize; 4]); 2] =
    [("reference", [8, 16, 32, 32]), ("narrow", [4, 8, 16, 16])];
const TURNS: usize = 15;
/// Number of irreps of D2.
const IRREPS: usize = 4;

/// Matrices of one irrep of a layer, for a chunk of images.
struct Product {
    patches: Mat<f32>,
    weights: Mat<f32>,
    out: Mat<f32>,
    d_patches: Option<Mat<f32>>,
    d_weights: Mat<f32>,
}

impl Product {
    fn new(pixels: usize, folded: usize, fields: usize, first: bool) -> Product {
        let filled =
            |rows, cols| Mat::from_fn(rows, cols, |i, j| ((i * 37 + j) % 101) as f32 / 50.0 - 1.0);
        Product {
            patches: filled(pixels, folded),
            weights: filled(folded, fields),
            out: filled(pixels, fields),
            d_patches: (!first).then(|| filled(pixels, folded)),
            d_weights: filled(folded, fields),
        }
    }

    fn forward(&mut self) {
        multiply(&mut self.out, self.patches.as_ref(), self.weights.as_ref());
    }

    fn backward(&mut self) {
        multiply(&mut self.d_weights, self.patches.transpose(), self.out.as_ref());
        if let Some(d_patches) = &mut self.d_patches {
            multiply(d_patches, self.out.as_ref(), self.weights.transpose());
        }
    }
}

fn multiply(to: &mut Mat<f32>, a: MatRef<f32>, b: MatRef<f32>) {
    matmul(to.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
}

/// Returns the four products of every layer, in the order of the layers.
fn products(fields: [usize; 4]) -> Vec<Product> {
    let (mut channels, mut size) = (IMAGE_CHANNELS, SIZE);
    let layers = fields.iter().enumerate().flat_map(|(layer, &fields)| {
        size /= HALVING_CONV_WINDOW.stride;
        // a fourth of the patch for each irrep
        let folded = HALVING_CONV_WINDOW.size * HALVING_CONV_WINDOW.size * channels / IRREPS;
        channels = IRREPS * fields;
        [(); IRREPS].map(|()| Product::new(CHUNK * size * size, folded, fields, layer == 0))
    });
    layers.collect()
}

/// Network with a chunk of images.
struct Passes {
    net: Sequential<f32>,
    params: Vec<f32>,
    gradient: Vec<f32>,
    x: Vec<f32>,
    y: Vec<f32>,
    scratch: Scratch<f32>,
}

impl Passes {
    fn new(fields: [usize; 4]) -> Result<Passes, LayerError> {
        let net = build_d2_conv_network(SIZE, &fields, false)?;
        let mut params = vec![0.0; net.num_params()];
        net.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
        let pixels = 0..CHUNK * net.in_shape().len();
        Ok(Passes {
            gradient: vec![0.0; params.len()],
            x: pixels.map(|i| (i * 37 % 101) as f32 / 50.0 - 1.0).collect(),
            y: vec![0.0; CHUNK * net.out_shape().len()],
            scratch: net.allocate_scratch(CHUNK),
            params,
            net,
        })
    }

    fn forward(&mut self) {
        self.net.forward(&self.params, &self.x, &mut self.y, &mut self.scratch);
    }

    fn backward(&mut self) {
        let (x, y, gradient) = (&self.x, &self.y, &mut self.gradient);
        // the gradient of half the squared output
        self.net.backward(&self.params, x, y, y, None, gradient, &mut self.scratch);
    }
}

fn timed(mut chunk: impl FnMut()) -> f64 {
    let clock = Instant::now();
    for _ in 0..IMAGES / CHUNK {
        chunk();
    }
    1e3 * clock.elapsed().as_secs_f64()
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() -> Result<(), LayerError> {
    println!("network    pass         ours   products   products/ours");
    for (name, fields) in NETWORKS {
        let (mut passes, mut products) = (Passes::new(fields)?, products(fields));
        for (pass, backward) in [("inference", false), ("training", true)] {
            let mut times = [const { Vec::new() }; 2];
            for _ in 0..TURNS {
                times[0].push(timed(|| {
                    passes.forward();
                    if backward {
                        passes.backward();
                    }
                }));
                times[1].push(timed(|| {
                    products.iter_mut().for_each(Product::forward);
                    if backward {
                        products.iter_mut().rev().for_each(Product::backward);
                    }
                }));
            }
            let [ours, theirs] = times.map(|mut times| median(&mut times));
            println!("{name:<10} {pass:<9} {ours:7.2}   {theirs:8.2}   {:13.2}", theirs / ours);
        }
    }
    Ok(())
}

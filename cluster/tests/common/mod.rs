//! Random clouds, costs and weights for the tests.

// each test file uses its part
#![allow(dead_code)]

use cluster::{ClusterError, PointWeights, TransportPlan, solve_transport};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws a standard normal number (Box-Muller).
pub fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}

pub fn normals(rng: &mut ChaCha8Rng, len: usize) -> Vec<f32> {
    (0..len).map(|_| normal(rng)).collect()
}

/// Draws `len` costs from [-1, 1).
pub fn random_costs(seed: u64, len: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

pub fn random_weights(seed: u64, len: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let weights: Vec<f64> = (0..len).map(|_| rng.random_range(0.0..1.0)).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| w / sum).collect()
}

/// Solves a problem with equal weights.
pub fn uniform(cost: &[f64], n: usize, m: usize) -> Result<TransportPlan, ClusterError> {
    solve_transport(cost, PointWeights::Uniform(n), PointWeights::Uniform(m))
}

/// The distances `[n, m]` by their definition, in double precision.
pub fn distances(x: &[f32], y: &[f32], dim: usize) -> Vec<f64> {
    let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
    let distance = |p: &[f32], q: &[f32]| p.iter().zip(q).map(square).sum::<f64>().sqrt();
    let rows = x.chunks_exact(dim);
    rows.flat_map(|p| y.chunks_exact(dim).map(move |q| distance(p, q))).collect()
}

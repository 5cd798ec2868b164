//! Random clouds for the tests.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Draws a standard normal number (Box-Muller).
pub fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}

/// Draws `len` standard normal numbers.
pub fn normals(rng: &mut ChaCha8Rng, len: usize) -> Vec<f32> {
    (0..len).map(|_| normal(rng)).collect()
}

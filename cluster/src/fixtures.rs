//! Random points, for the unit tests.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Numbers within 1 of the centre.
pub fn draw(count: usize, centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let draw = |_| centre + rng.random_range(-1.0..1.0);
    (0..count).map(draw).collect()
}

//! Random numbers of a simulated camera.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A number of mean 0 and variance 1: the sum of four even ones, which is a normal one but for its
/// tails, which end at 3.5.
pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f32 {
    /// Variance of four numbers that are even in 0..65536.
    const VARIANCE: f32 = 4.0 * (65536.0 * 65536.0 - 1.0) / 12.0;
    let bits: u64 = rng.random();
    let part = |shift: u32| bits >> shift & 0xffff;
    let sum: u64 = [0, 16, 32, 48].map(part).iter().sum();
    (sum as f32 - 2.0 * 65535.0) / VARIANCE.sqrt()
}

/// A unit vector, all directions alike.
pub(crate) fn direction(rng: &mut ChaCha8Rng) -> DVec3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    let (sine, cosine) = rng.random_range(0.0..TAU).sin_cos();
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * cosine, across * sine, z)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn numbers_have_mean_0_and_variance_1_and_directions_length_1() {
        let rng = &mut ChaCha8Rng::seed_from_u64(1000);
        let numbers: Vec<f64> = (0..100_000).map(|_| f64::from(normal(rng))).collect();
        let mean = |power: i32| numbers.iter().map(|n| n.powi(power)).sum::<f64>() / 1e5;
        assert!(
            mean(1).abs() < 0.01 && mean(3).abs() < 0.03,
            "{} {}",
            mean(1),
            mean(3)
        );
        assert!((mean(2) - 1.0).abs() < 0.01, "{}", mean(2));
        // 3 for a normal distribution; four even numbers have 3 - 1.2 / 4
        assert!((mean(4) - 2.7).abs() < 0.05, "{}", mean(4));
        let sum: DVec3 = (0..10_000).map(|_| direction(rng)).sum();
        assert!(sum.length() < 200.0, "{sum}");
        assert!((direction(rng).length() - 1.0).abs() < 1e-12);
    }
}

//! Normal deviates for initial weights.

use std::f64::consts::TAU;

use rand::{Rng, RngExt};

use crate::real::Real;

/// Fills `out` with independent normal deviates of mean 0 (Box and Muller, 1958).
pub(crate) fn fill_normal<T: Real>(rng: &mut dyn Rng, std: f64, out: &mut [T]) {
    for pair in out.chunks_mut(2) {
        // 1 - u lies in (0, 1], where the logarithm is finite
        let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt() * std;
        let angle = TAU * rng.random::<f64>();
        let (sin, cos) = angle.sin_cos();
        let values = [radius * cos, radius * sin];
        for (out, value) in pair.iter_mut().zip(values) {
            *out = T::from_f64(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    #[test]
    fn deviates_have_the_moments_of_the_normal_distribution() {
        let mut values = vec![0.0f64; 100_001];
        fill_normal(&mut ChaCha8Rng::seed_from_u64(0), 3.0, &mut values);
        let moment = |k| values.iter().map(|v| v.powi(k)).sum::<f64>() / values.len() as f64;
        assert!(moment(1).abs() < 0.04);
        assert!((moment(2) / 9.0 - 1.0).abs() < 0.03);
        assert!((moment(4) / 81.0 - 3.0).abs() < 0.2);
    }
}

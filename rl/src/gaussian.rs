//! The diagonal Gaussian from which actions are drawn: `[A]` means and `[A]` logarithms of standard
//! deviations.
//!
//! Everything is summed in f64, since log-probabilities are subtracted from one another and
//! exponentiated.

use std::f64::consts::{PI, TAU};

use rand::{Rng, RngExt};

/// Fills `out` with independent standard normal numbers: Box and Muller, "A note on the generation
/// of random normal deviates" (Ann. Math. Statist. 29, 1958). Two uniform numbers a pair, so the
/// stream position depends on the length alone.
pub(crate) fn standard_normals(rng: &mut impl Rng, out: &mut [f32]) {
    for pair in out.chunks_mut(2) {
        let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
        // 1 - u lies in (0, 1], so the logarithm is finite
        let radius = (-2.0 * (1.0 - u).ln()).sqrt();
        for (x, f) in pair.iter_mut().zip([f64::cos, f64::sin]) {
            *x = (radius * f(TAU * v)) as f32;
        }
    }
}

/// ln N(action; mean, exp(log_std)^2), summed over components.
pub(crate) fn log_prob(mean: &[f64], log_std: &[f64], action: &[f64]) -> f64 {
    let mut sum = 0.0;
    for ((m, s), a) in mean.iter().zip(log_std).zip(action) {
        sum -= 0.5 * ((a - m) * (-s).exp()).powi(2) + s + 0.5 * TAU.ln();
    }
    sum
}

/// Differential entropy in nats: sum of log_std + ln(2 pi e) / 2.
pub(crate) fn entropy(log_std: &[f64]) -> f64 {
    log_std
        .iter()
        .map(|s| s + 0.5 * ((2.0 * PI).ln() + 1.0))
        .sum()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn normals_have_unit_moments() {
        let mut x = vec![0.0; 20_001];
        standard_normals(&mut ChaCha8Rng::seed_from_u64(1), &mut x);
        let moment = |k| x.iter().map(|&v| f64::from(v).powi(k)).sum::<f64>() / x.len() as f64;
        // standard errors: 0.007, 0.010, 0.027, 0.069
        assert!(moment(1).abs() < 0.03 && (moment(2) - 1.0).abs() < 0.04);
        assert!(moment(3).abs() < 0.1 && (moment(4) - 3.0).abs() < 0.3);
    }

    /// Density of N(1, 4) at 2: exp(-1/8) / (2 sqrt(2 pi)) = 0.176032663...
    #[test]
    fn log_prob_by_hand() {
        let p = log_prob(&[1.0], &[2f64.ln()], &[2.0]).exp();
        assert!((p - 0.176_032_663_382_149_74).abs() < 1e-12, "{p}");
        let two = log_prob(&[1.0, 1.0], &[2f64.ln(); 2], &[2.0, 2.0]).exp();
        assert!((two - p * p).abs() < 1e-12);
    }

    /// The entropy is the expectation of -ln p, here by the midpoint rule.
    #[test]
    fn entropy_is_the_expected_surprise() {
        let (mean, log_std, dx) = ([0.3], [-0.5], 1e-3);
        let surprise: f64 = (-8000..8000)
            .map(|i| log_prob(&mean, &log_std, &[(f64::from(i) + 0.5) * dx]))
            .map(|lp| -lp * lp.exp() * dx)
            .sum();
        assert!((surprise - entropy(&log_std)).abs() < 1e-6);
    }
}

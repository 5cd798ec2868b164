//! Random drift of a camera's exposure and white balance.

use rand_chacha::ChaCha8Rng;

use crate::imperfections::CameraImperfections;
use crate::sensor::standard_normal;

/// Drift of a camera's gains, whose logarithms are Ornstein-Uhlenbeck processes about zero that
/// each picture samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct GainDrift {
    /// Logarithms of the gains of all light, of red and of blue, in standard deviations.
    logarithms: [f64; 3],
    /// Time (seconds) at which the camera's gains were last drawn; `None` before the first picture.
    drawn: Option<f64>,
}

impl GainDrift {
    /// Samples the gains of red, green and blue at the time `now` (seconds), which must not
    /// decrease from call to call.
    pub(crate) fn sample_gains(
        &mut self,
        imperfections: &CameraImperfections,
        now: f64,
        rng: &mut ChaCha8Rng,
    ) -> [f64; 3] {
        // an infinite time before the first sample draws it from the stationary distribution
        let passed = self.drawn.map_or(f64::INFINITY, |drawn| now - drawn);
        let kept = (-passed / imperfections.drift_correlation_time).exp();
        // keeps the variance at 1
        let fresh = (1.0 - kept * kept).max(0.0).sqrt();
        for logarithm in &mut self.logarithms {
            *logarithm = kept * *logarithm + fresh * f64::from(standard_normal(rng));
        }
        self.drawn = Some(now);
        let [exposure, red, blue] = self.logarithms;
        let exposure = imperfections.exposure_drift_sd * exposure;
        let of =
            |deviation: f64| (exposure + imperfections.white_balance_drift_sd * deviation).exp();
        [of(red), of(0.0), of(blue)]
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const DRIFTING: CameraImperfections = CameraImperfections {
        exposure_drift_sd: 0.2,
        white_balance_drift_sd: 0.05,
        drift_correlation_time: 2.0,
        ..CameraImperfections::NO_IMPERFECTIONS
    };

    /// Logarithms of the gains every `period` seconds.
    fn watched(period: f64, count: usize) -> Vec<[f64; 3]> {
        let rng = &mut ChaCha8Rng::seed_from_u64(1000);
        let mut drift = GainDrift::default();
        let times = (0..count).map(|i| i as f64 * period);
        times.map(|now| drift.sample_gains(&DRIFTING, now, rng).map(f64::ln)).collect()
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
        sum / count
    }

    #[test]
    fn gains_wander_as_far_and_as_fast_as_they_should() {
        let drawn = watched(0.5, 200_000);
        let green = |i: usize| drawn[i][1];
        let variance = mean((0..drawn.len()).map(|i| green(i).powi(2)));
        assert!((variance.sqrt() - 0.2).abs() < 0.005, "{variance}");
        // after a second, half of the time, e^-0.5 of it is left
        let left = mean((2..drawn.len()).map(|i| green(i) * green(i - 2))) / variance;
        assert!((left - (-0.5_f64).exp()).abs() < 0.02, "{left}");
        for other in [0, 2] {
            let balance = mean(drawn.iter().map(|gains| (gains[other] - gains[1]).powi(2)));
            assert!((balance.sqrt() - 0.05).abs() < 0.002, "{balance}");
        }
        let shared = mean(drawn.iter().map(|gains| (gains[0] - gains[1]) * (gains[2] - gains[1])));
        assert!(shared.abs() < 1e-4, "red and blue wander apart: {shared}");
    }

    #[test]
    fn the_same_time_has_the_same_gains_and_without_drift_they_are_1() {
        let rng = &mut ChaCha8Rng::seed_from_u64(1001);
        let mut drift = GainDrift::default();
        let first = drift.sample_gains(&DRIFTING, 3.0, rng);
        assert_eq!(drift.sample_gains(&DRIFTING, 3.0, rng), first);
        assert_ne!(drift.sample_gains(&DRIFTING, 4.0, rng), first);
        assert_eq!(drift.sample_gains(&CameraImperfections::NO_IMPERFECTIONS, 9.0, rng), [1.0; 3]);
    }
}

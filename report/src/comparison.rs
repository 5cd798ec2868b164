//! Comparison of two methods by their scores: Welch's t, a permutation test, and equivalence.

use experiments::evaluation::mean;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::statistics::{ConfidenceInterval, MethodScores};

/// Largest p-value at which a test rejects.
const LEVEL: f64 = 0.05;
/// Largest difference of the means of two methods that count as equal.
pub const EQUIVALENCE_MARGIN: f64 = 0.05;
/// Number of random divisions of the runs in a permutation test.
const PERMUTATIONS: u32 = 99_999;
/// Difference of means by which two divisions of the same runs count as equal, because of rounding
/// errors.
const ROUNDING_TOLERANCE: f64 = 1e-12;

/// Outcome of the hypothesis "the first method scores above the second"
/// (docs/results/protocol.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HypothesisOutcome {
    /// Difference above zero by Welch's t and by the permutation test.
    Confirmed,
    /// Difference below zero by Welch's t and by the permutation test.
    Refuted,
    /// Difference within [`EQUIVALENCE_MARGIN`] of zero, by two one-sided tests (TOST): the 90 %
    /// interval of Welch's t lies within the margin.
    Equivalent,
    /// Difference that may be zero or larger than the margin.
    Undecided,
    /// No outcome, since a method has fewer than two seeds.
    TooFewSeeds,
}

/// Comparison of the scores of two methods on the same task groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MethodComparison {
    /// Mean score of the first method minus that of the second.
    pub mean_difference: f64,
    /// Welch's t-test of the means of runs; `None` for fewer than two seeds, or if all runs of each
    /// method have the same mean.
    pub welch: Option<WelchTest>,
    /// Two-sided p-value of the difference of means under random exchange of runs between the
    /// methods; `None` for fewer than two seeds.
    pub permutation_p_value: Option<f64>,
}

/// Welch's t-test of the difference of two means, which assumes no equal variances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WelchTest {
    /// 95 % interval of the difference.
    pub interval: ConfidenceInterval,
    /// 90 % interval of the difference, for the test of equivalence.
    pub narrow_interval: ConfidenceInterval,
    /// Two-sided p-value of no difference.
    pub p_value: f64,
}

impl MethodComparison {
    /// Compares two methods' scores on the same task groups; a positive difference means that `one`
    /// scores higher than `other`.
    pub fn new(one: &MethodScores, other: &MethodScores) -> Self {
        let (ours, theirs) = (one.run_means(), other.run_means());
        Self {
            mean_difference: one.pooled_statistic(mean) - other.pooled_statistic(mean),
            welch: WelchTest::new(&ours, &theirs),
            permutation_p_value: permutation_p_value(&ours, &theirs),
        }
    }

    /// Returns the outcome of the hypothesis "the first method scores above the second". A
    /// difference is confirmed or refuted if both tests reject at 5 %, which three runs against
    /// three cannot reach: at best, 2 of 20 divisions are as far apart.
    pub fn outcome(&self) -> HypothesisOutcome {
        let Some(permutation) = self.permutation_p_value else {
            return HypothesisOutcome::TooFewSeeds;
        };
        let without_spread =
            ConfidenceInterval { low: self.mean_difference, high: self.mean_difference };
        // without any spread, Welch's t of a difference is infinite
        let welch = self.welch.map_or(0.0, |test| test.p_value);
        let narrow = self.welch.map_or(without_spread, |test| test.narrow_interval);
        if self.mean_difference != 0.0 && welch.max(permutation) <= LEVEL {
            let is_above = self.mean_difference > 0.0;
            return if is_above {
                HypothesisOutcome::Confirmed
            } else {
                HypothesisOutcome::Refuted
            };
        }
        if narrow.low >= -EQUIVALENCE_MARGIN && narrow.high <= EQUIVALENCE_MARGIN {
            return HypothesisOutcome::Equivalent;
        }
        HypothesisOutcome::Undecided
    }
}

impl HypothesisOutcome {
    /// Returns the hypothesis outcome in words, for a table cell.
    pub fn label(self) -> &'static str {
        match self {
            Self::Confirmed => "above",
            Self::Refuted => "below",
            Self::Equivalent => "equal within 0.05",
            Self::Undecided => "not told apart",
            Self::TooFewSeeds => "too few seeds (two of each are needed)",
        }
    }
}

impl WelchTest {
    /// Tests the difference of the means of two samples. `None` for fewer than two values of
    /// either, or if neither varies.
    pub fn new(one: &[f64], other: &[f64]) -> Option<Self> {
        // squared standard error of the mean, and its degrees of freedom
        let spread = |values: &[f64]| {
            let degrees = values.len().checked_sub(1).filter(|&degrees| degrees > 0)? as f64;
            let centre = mean(values);
            let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
            Some((squares / degrees / values.len() as f64, degrees))
        };
        let ((ours, our_degrees), (theirs, their_degrees)) = (spread(one)?, spread(other)?);
        let squared_error = ours + theirs;
        let degrees =
            squared_error.powi(2) / (ours.powi(2) / our_degrees + theirs.powi(2) / their_degrees);
        // `degrees` is NaN if neither sample varies
        let t = StudentsT::new(0.0, 1.0, degrees).ok()?;
        let (error, difference) = (squared_error.sqrt(), mean(one) - mean(other));
        let interval = |quantile: f64| {
            let reach = error * t.inverse_cdf(quantile);
            ConfidenceInterval { low: difference - reach, high: difference + reach }
        };
        Some(Self {
            interval: interval(0.975),
            narrow_interval: interval(0.95),
            p_value: 2.0 * t.sf((difference / error).abs()),
        })
    }
}

/// Returns the two-sided p-value of the difference of two means under random exchange of the
/// values; the given division counts as one of the random ones. `None` for fewer than two values of
/// either.
fn permutation_p_value(one: &[f64], other: &[f64]) -> Option<f64> {
    if one.len().min(other.len()) < 2 {
        return None;
    }
    let observed = (mean(one) - mean(other)).abs();
    let mut pooled = [one, other].concat();
    // a fixed seed: the same runs give the same report
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let as_far = (0..PERMUTATIONS).filter(|_| {
        for place in 0..one.len() {
            let from = rng.random_range(place..pooled.len());
            pooled.swap(place, from);
        }
        let (ours, theirs) = pooled.split_at(one.len());
        (mean(ours) - mean(theirs)).abs() >= observed - ROUNDING_TOLERANCE
    });
    Some((as_far.count() as f64 + 1.0) / f64::from(PERMUTATIONS + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(one: &[f64], other: &[f64]) -> HypothesisOutcome {
        let [one, other] = [one, other].map(|runs| MethodScores::new(vec![runs.to_vec()]));
        MethodComparison::new(&one, &other).outcome()
    }

    #[test]
    fn outcomes_follow_both_tests_and_the_margin() {
        let (high, low) = ([0.9, 1.0, 0.95, 0.97], [0.2, 0.1, 0.3, 0.25]);
        assert_eq!(outcome(&high, &low), HypothesisOutcome::Confirmed);
        assert_eq!(outcome(&low, &high), HypothesisOutcome::Refuted);
        // Welch's t rejects, but 2 of 20 divisions of three and three runs are as far apart
        assert_eq!(outcome(&high[..3], &low[..3]), HypothesisOutcome::Undecided);
        let [close, closer] = [[0.95, 0.97, 0.96, 0.95], [0.94, 0.97, 0.96, 0.94]];
        assert_eq!(outcome(&close, &closer), HypothesisOutcome::Equivalent);
        assert_eq!(outcome(&[1.0; 4], &[1.0; 4]), HypothesisOutcome::Equivalent);
        assert_eq!(outcome(&[1.0; 4], &[0.5; 4]), HypothesisOutcome::Confirmed);
        assert_eq!(outcome(&[1.0, 0.4, 0.7, 0.2], &low), HypothesisOutcome::Undecided);
        // 1 of 56 divisions is as far apart, but Welch's t does not reject (p = 0.059)
        let [steady, spread] =
            [[0.993, 0.994, 0.999, 0.991, 0.997].as_slice(), &[0.692, 0.621, 0.856]];
        assert_eq!(outcome(steady, spread), HypothesisOutcome::Undecided);
        assert_eq!(outcome(&high, &[0.9]), HypothesisOutcome::TooFewSeeds);
    }

    #[test]
    fn welchs_t_is_that_of_scipy() {
        // scipy.stats.ttest_ind(a, b, equal_var=False): p-value, confidence_interval(0.95, 0.9)
        let test = WelchTest::new(&[0.9, 1.0, 0.95, 0.97], &[0.2, 0.4, 0.3]).unwrap();
        for (computed, expected) in [
            (test.p_value, 0.003588571676423085),
            (test.interval.low, 0.43755030850942495),
            (test.interval.high, 0.8724496914905746),
            (test.narrow_interval.low, 0.498939717178174),
            (test.narrow_interval.high, 0.8110602828218256),
        ] {
            assert!((computed - expected).abs() < 1e-9, "{computed} {expected}");
        }
        assert_eq!(WelchTest::new(&[0.9], &[0.2, 0.4]), None);
        assert_eq!(WelchTest::new(&[0.9, 0.9], &[0.2, 0.2]), None);
    }

    #[test]
    fn a_permutation_test_counts_divisions_that_are_as_far_apart() {
        // 2 of the 70 divisions separate all
        let apart = permutation_p_value(&[5.0, 6.0, 7.0, 8.0], &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((apart - 2.0 / 70.0).abs() < 0.003, "{apart}");
        assert_eq!(permutation_p_value(&[1.0, 2.0], &[2.0, 1.0]), Some(1.0));
        assert_eq!(permutation_p_value(&[1.0], &[2.0, 1.0]), None);
    }
}

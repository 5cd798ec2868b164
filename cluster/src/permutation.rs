//! Permutation test of a score, with its distribution over random splits of pooled episodes.

use statrs::function::gamma::checked_gamma_ur;

/// Rounding allowance for Wasserstein distances, as a fraction of the largest distance between
/// pooled points.
pub(crate) const ROUNDING: f64 = 1e-9;

/// Moments and maximum of a joint test's largest score over random splits of the pooled episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NullDistribution {
    /// Number of random splits of the pooled episodes.
    pub permutations: usize,
    /// Mean of the score over random splits.
    pub mean: f64,
    /// Standard deviation of the score over random splits.
    pub sd: f64,
    /// Skewness over random splits, the third standardised moment; distances are skewed to the
    /// right.
    pub skewness: f64,
    /// Largest score of a random split.
    pub max: f64,
}

/// Result of a permutation test: score, p-values and null distribution. All values are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PermutationTestResult {
    /// Distribution of the score over random splits, as if episodes of rollout and buffer were
    /// exchangeable.
    pub null: NullDistribution,
    /// Score of the observed split, standardised by `null`; zero where all splits agree.
    pub score: f64,
    /// Share of splits, including the observed one, whose score is at least the observed one, in
    /// `(0, 1]`. Exact: for exchangeable episodes it is at most `a` with probability at most `a`,
    /// whatever the features.
    pub p_value: f64,
    /// P-value of the score under the Pearson type III distribution with the moments of `null`, in
    /// `[0, 1]`. It is an approximation, for levels that the number of splits does not resolve.
    pub tail_p_value: f64,
}

impl NullDistribution {
    /// Computes the moments of a null distribution from the scores of all random splits.
    pub(crate) fn new(mut splits: Vec<f64>) -> Self {
        splits.sort_unstable_by(f64::total_cmp);
        let count = splits.len() as f64;
        let mean = splits.iter().sum::<f64>() / count;
        let squares = splits.iter().map(|w| (w - mean).powi(2)).sum::<f64>();
        // 0 for a single split
        let sd = (squares / (count - 1.0).max(1.0)).sqrt();
        let cubes = splits.iter().map(|w| ((w - mean) / sd.max(ROUNDING)).powi(3));
        Self {
            permutations: splits.len(),
            mean,
            sd,
            skewness: cubes.sum::<f64>() / count,
            max: splits.last().copied().unwrap_or(0.0),
        }
    }

    /// Returns a score in standard deviations above the mean of the null distribution; 0 for a
    /// single split, which tells nothing about deviations.
    pub(crate) fn standardise(&self, score: f64) -> f64 {
        if self.permutations < 2 {
            return 0.0;
        }
        (score - self.mean) / self.sd.max(ROUNDING)
    }

    /// Returns the probability of a larger standardised score under a Pearson type III
    /// distribution, with the skewness of the null distribution raised by its standard error.
    pub(crate) fn tail(&self, standardised: f64) -> f64 {
        // raised by the standard error of a normal sample's skewness, since a tail that is taken
        // for too light costs a false alarm, and one that is taken for too heavy little
        let error = (6.0 / self.permutations as f64).sqrt();
        pearson3_tail(standardised, self.skewness.max(0.0) + error)
    }
}

/// Least skewness of the Pearson type III distribution, which replaces smaller ones: with it, the
/// shape of the gamma distribution, `4 / skewness^2`, is 400.
const LEAST_SKEWNESS: f64 = 0.1;

/// Returns the probability that a variable of mean 0, standard deviation 1 and the given skewness
/// exceeds `score`, in `[0, 1]`.
///
/// With `a = 4 / skewness^2` this is `Q(a, a + score sqrt(a))`, where `Q` is the regularised upper
/// incomplete gamma function. Permutation distributions of distances are close to this family:
/// Mielke and Berry, "Permutation Methods: A Distance Function Approach" (2001), chapter 2.
fn pearson3_tail(score: f64, skewness: f64) -> f64 {
    let shape = 4.0 / skewness.max(LEAST_SKEWNESS).powi(2);
    let x = (shape + score * shape.sqrt()).min(f64::MAX);
    // only `x <= 0` is refused, where all of the distribution lies above
    checked_gamma_ur(shape, x).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_null_distribution() {
        // 0, 1, ..., 100, in an order that is not sorted
        let null = NullDistribution::new((0..=100).map(|i| f64::from(i * 37 % 101)).collect());
        assert_eq!((null.permutations, null.mean, null.max), (101, 50.0, 100.0));
        assert!((null.sd - 858.5_f64.sqrt()).abs() < 1e-12 && null.skewness.abs() < 1e-12);
        let still = NullDistribution::new(vec![1.0; 20]);
        assert_eq!((still.sd, still.skewness, still.standardise(1.0)), (0.0, 0.0, 0.0));
        assert!(still.tail(0.0) > 0.1);
    }

    fn assert_close(got: f64, expected: f64) {
        assert!((got - expected).abs() <= 1e-11 * expected, "{got:e} is not {expected:e}");
    }

    /// Gamma distributions of whole shapes, and that of shape 1/2: erfc of the root, from tables.
    #[test]
    fn agrees_with_closed_forms() {
        for shape in [1_u16, 2, 3, 25, 100, 400] {
            let root = f64::from(shape).sqrt();
            for score in [-0.5, 0.0, 3.0, 6.0, 12.0] {
                let x = f64::from(shape) + score * root;
                let poisson = (1..shape).scan((-x).exp(), |term, k| {
                    *term *= x / f64::from(k);
                    Some(*term)
                });
                let expected = (-x).exp() + poisson.sum::<f64>();
                assert_close(pearson3_tail(score, 2.0 / root), expected);
            }
        }
        for (root, erfc) in [
            (0.5, 0.479_500_122_186_953_5),
            (1.0, 0.157_299_207_050_285_13),
            (2.0, 0.004_677_734_981_047_266),
        ] {
            let score = (root * root - 0.5) / 0.5_f64.sqrt();
            assert_close(pearson3_tail(score, 8.0_f64.sqrt()), erfc);
        }
    }

    #[test]
    fn stays_a_probability_at_the_extremes() {
        for skewness in [-3.0, 0.0, 1e-9, 0.1, 1.0, 3.0, 30.0] {
            let mut last = 1.0;
            for score in [f64::MIN, -1e9, -3.0, 0.0, 1.0, 5.0, 40.0, 1e9, f64::MAX] {
                let p = pearson3_tail(score, skewness);
                assert!((0.0..=last).contains(&p), "{skewness} {score}: {p}");
                last = p;
            }
        }
    }
}

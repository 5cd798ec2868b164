//! Upper tail of the Pearson type III distribution, the gamma distribution that has been shifted
//! and scaled to given moments.

use statrs::function::gamma::checked_gamma_ur;

/// Skewness below which the distribution is taken for this one: with it, the shape of the gamma
/// distribution, `4 / skewness^2`, is 400.
const LEAST_SKEWNESS: f64 = 0.1;

/// Returns the probability that a variable of mean 0, standard deviation 1 and the given skewness
/// exceeds `score`, in `[0, 1]`.
///
/// With `a = 4 / skewness^2` this is `Q(a, a + score sqrt(a))`, where `Q` is the regularised upper
/// incomplete gamma function. Permutation distributions of distances are close to this family:
/// Mielke and Berry, "Permutation Methods: A Distance Function Approach" (2001), chapter 2.
pub(crate) fn pearson3_tail(score: f64, skewness: f64) -> f64 {
    let shape = 4.0 / skewness.max(LEAST_SKEWNESS).powi(2);
    let x = (shape + score * shape.sqrt()).min(f64::MAX);
    // only `x <= 0` is refused, where all of the distribution lies above
    checked_gamma_ur(shape, x).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_close(got: f64, expected: f64) {
        assert!((got - expected).abs() <= 1e-11 * expected, "{got:e} is not {expected:e}");
    }

    #[test]
    #[should_panic(expected = "NaN is not 1e0")]
    fn the_comparison_sees_nan() {
        assert_close(f64::NAN, 1.0);
    }

    #[test]
    fn agrees_with_closed_forms() {
        // skewness 2 is the exponential distribution
        for score in [-0.5_f64, 0.0, 3.0, 12.0] {
            assert_close(pearson3_tail(score, 2.0), (-1.0 - score).exp());
        }
        // the gamma distributions of shapes 2 and 3
        for score in [-1.0_f64, 0.0, 3.0, 12.0] {
            let x = 2.0 + score * 2.0_f64.sqrt();
            let tail = (1.0 + x) * (-x).exp();
            assert_close(pearson3_tail(score, 2.0_f64.sqrt()), tail);
            let x3 = 3.0 + score * 3.0_f64.sqrt();
            let tail3 = (1.0 + x3 + x3 * x3 / 2.0) * (-x3).exp();
            assert_close(pearson3_tail(score, 2.0 / 3.0_f64.sqrt()), tail3);
        }
        // that of shape 1/2: erfc of the root, from tables
        for (root, erfc) in [
            (0.5, 0.479_500_122_186_953_5),
            (1.0, 0.157_299_207_050_285_13),
            (2.0, 0.004_677_734_981_047_266),
        ] {
            let score = (root * root - 0.5) / 0.5_f64.sqrt();
            assert_close(pearson3_tail(score, 8.0_f64.sqrt()), erfc);
        }
    }

    /// The density `x^(a - 1) e^-x`, integrated by Simpson's rule.
    #[test]
    fn agrees_with_quadrature() {
        let integral = |a: f64, from: f64, to: f64| {
            let steps = 200_000;
            let h = (to - from) / f64::from(steps);
            let f = |i: i32| {
                let x = from + h * f64::from(i);
                ((a - 1.0) * (x / a).ln() - x + a).exp()
            };
            let inner: f64 = (1..steps).map(|i| f(i) * f64::from(2 + 2 * (i % 2))).sum();
            (f(0) + inner + f(steps)) * h / 3.0
        };
        for skewness in [0.1, 0.3, 0.7, 1.2] {
            let a = 4.0 / f64::powi(skewness, 2);
            let end = a + 40.0 * a.sqrt() + 60.0;
            let whole = integral(a, 1e-9, end);
            for score in [-2.0, 0.0, 0.05, 1.0, 3.0, 6.0] {
                let at = a + score * a.sqrt();
                if at > 0.0 {
                    let expected = integral(a, at, end) / whole;
                    let got = pearson3_tail(score, skewness);
                    assert!(
                        (got / expected - 1.0).abs() < 1e-7,
                        "{skewness} {score}: {got:e} {expected:e}"
                    );
                }
            }
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

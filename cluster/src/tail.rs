//! Upper tail of the Pearson type III distribution, the gamma distribution that has been shifted
//! and scaled to given moments.

/// Skewness below which the distribution is taken for this one: the shape of the gamma
/// distribution, `4 / skewness^2`, stays small enough for [`TERMS`] terms.
const LEAST_SKEWNESS: f64 = 0.1;
/// Terms of the series and of the continued fraction; at shape 400 the last one is below 1e-20 of
/// the first.
const TERMS: usize = 200;

/// Returns the probability that a variable of mean 0, standard deviation 1 and the given skewness
/// exceeds `score`, in `[0, 1]`.
///
/// With `a = 4 / skewness^2` this is `Q(a, a + score sqrt(a))`, where `Q` is the regularised
/// incomplete gamma function. Permutation distributions of distances are close to this family:
/// Mielke and Berry, "Permutation Methods: A Distance Function Approach" (2001), chapter 2.
pub(crate) fn pearson3_tail(score: f64, skewness: f64) -> f64 {
    let shape = 4.0 / skewness.max(LEAST_SKEWNESS).powi(2);
    gamma_tail(shape, (shape + score * shape.sqrt()).min(f64::MAX))
}

/// `Q(a, x) = Gamma(a, x) / Gamma(a)` for `a > 0` (DLMF 8.2.4): one minus the series 8.7.1 below
/// `a + 1`, the even part of the continued fraction 8.9.2 above.
fn gamma_tail(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        1.0 - scale * lower_series(a, x)
    } else {
        scale / upper_fraction(a, x)
    }
}

/// `sum_n x^n / (a (a + 1) ... (a + n))`.
fn lower_series(a: f64, x: f64) -> f64 {
    let mut term = 1.0 / a;
    let mut sum = term;
    for n in 1..TERMS {
        term *= x / (a + n as f64);
        sum += term;
    }
    sum
}

/// `x + 1 - a + 1 (a - 1) / (x + 3 - a + 2 (a - 2) / (x + 5 - a + ...))`.
fn upper_fraction(a: f64, x: f64) -> f64 {
    let part = |n: usize| x + (2 * n + 1) as f64 - a;
    let inner = (1..TERMS)
        .rev()
        .fold(0.0, |rest, n| n as f64 * (a - n as f64) / (part(n) + rest));
    part(0) + inner
}

/// `ln Gamma(a)` by Stirling's series (DLMF 5.11.1), after `Gamma(a) = Gamma(a + 1) / a` has moved
/// the argument to where the series is exact to 1e-13.
fn ln_gamma(a: f64) -> f64 {
    let (mut a, mut shift) = (a, 0.0);
    while a < 12.0 {
        shift += a.ln();
        a += 1.0;
    }
    let correction = 1.0 / (12.0 * a) - 1.0 / (360.0 * a.powi(3)) + 1.0 / (1260.0 * a.powi(5))
        - 1.0 / (1680.0 * a.powi(7));
    (a - 0.5) * a.ln() - a + 0.5 * std::f64::consts::TAU.ln() + correction - shift
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_close(got: f64, expected: f64) {
        assert!(
            (got - expected).abs() <= 1e-11 * expected,
            "{got:e} is not {expected:e}"
        );
    }

    #[test]
    #[should_panic(expected = "NaN is not 1e0")]
    fn the_comparison_sees_nan() {
        assert_close(f64::NAN, 1.0);
    }

    #[test]
    fn agrees_with_closed_forms() {
        for x in [0.01_f64, 0.5, 1.0, 1.9, 2.1, 3.5, 10.0, 50.0] {
            assert_close(gamma_tail(1.0, x), (-x).exp());
            assert_close(gamma_tail(2.0, x), (1.0 + x) * (-x).exp());
            assert_close(gamma_tail(3.0, x), (1.0 + x + x * x / 2.0) * (-x).exp());
        }
        // Q(1/2, x^2) = erfc(x), from tables
        assert_close(gamma_tail(0.5, 1.0), 0.157_299_207_050_285_13);
        assert_close(gamma_tail(0.5, 4.0), 0.004_677_734_981_047_266);
        // skewness 2 is the exponential distribution
        for score in [-0.5_f64, 0.0, 3.0, 12.0] {
            assert_close(pearson3_tail(score, 2.0), (-1.0 - score).exp());
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

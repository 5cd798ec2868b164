//! The largest of some deviations, of which a NaN is the largest of all.

/// The largest of `deviations`; zero of none, and NaN where one of them is.
///
/// [`f64::max`] passes over NaN, and a check that folds with it passes over what is broken.
pub(crate) fn largest(deviations: impl IntoIterator<Item = f64>) -> f64 {
    let larger = |most: f64, one: f64| match most.is_nan() || most >= one {
        true => most,
        false => one,
    };
    deviations.into_iter().fold(0.0, larger)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_the_largest_wherever_it_stands() {
        assert_eq!(largest([]), 0.0);
        assert_eq!(largest([1.0, 3.0, 2.0]), 3.0);
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        for values in [[nan, 1.0, 2.0], [1.0, nan, 2.0], [1.0, infinite, nan]] {
            assert!(largest(values).is_nan(), "{values:?}");
        }
        assert_eq!(largest([1.0, infinite]), infinite);
    }
}

//! The largest of several numbers, where a NaN must show.

/// The largest of `numbers`, at least 0, and NaN as soon as one is: `f32::max` would drop it, and a
/// check against a tolerance would pass.
pub fn largest(numbers: impl IntoIterator<Item = f32>) -> f32 {
    let larger = |most: f32, x: f32| if most.is_nan() || x <= most { most } else { x };
    numbers.into_iter().fold(0.0, larger)
}

#[test]
fn a_nan_is_the_largest_number() {
    assert_eq!(largest([0.5, 2.0, 1.0]), 2.0);
    for at in 0..3 {
        let mut numbers = [0.5, 2.0, 1.0];
        numbers[at] = f32::NAN;
        assert!(largest(numbers).is_nan(), "{at}");
    }
}

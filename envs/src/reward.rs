//! Building blocks of rewards: tolerances in `[0, 1]` and their Hamacher product.
//!
//! Source: dm_control's `tolerance` as Meta-World's rewards use it.

/// Returns the long-tailed reward of a distance: 1 up to `bound`, beyond it `1 / (9 d^2 + 1)` with
/// `d = (distance - bound) / margin`.
///
/// The reward is 0.1 at `d = 1`. `distance`, `bound` and `margin` are in metres. With a margin of 0
/// the value beyond the bound is 0.
pub fn long_tail_reward(distance: f64, bound: f64, margin: f64) -> f64 {
    tolerance(distance, bound, margin, |d| 1.0 / (9.0 * d * d + 1.0))
}

/// Returns the long-tailed reward of a value that should be in `[low, high]`: 1 there, and beyond
/// either bound as in [`long_tail_reward`]. `margin` has the unit of the value.
pub fn long_tail_interval_reward(value: f64, [low, high]: [f64; 2], margin: f64) -> f64 {
    long_tail_reward((low - value).max(value - high), 0.0, margin)
}

/// Returns the Gaussian reward of a distance: 1 up to `bound`, beyond it `0.1^(d^2)` with `d =
/// (distance - bound) / margin`.
pub fn gaussian_reward(distance: f64, bound: f64, margin: f64) -> f64 {
    tolerance(distance, bound, margin, |d| 0.1_f64.powf(d * d))
}

fn tolerance(distance: f64, bound: f64, margin: f64, tail: impl Fn(f64) -> f64) -> f64 {
    if distance <= bound {
        1.0
    } else if margin == 0.0 {
        0.0
    } else {
        tail((distance - bound) / margin)
    }
}

/// Returns the Hamacher product `ab / (a + b - ab)` of two values in `[0, 1]`, a soft "and"; 0 if
/// the denominator is 0.
pub fn hamacher_product(a: f64, b: f64) -> f64 {
    let denominator = a + b - a * b;
    if denominator > 0.0 { a * b / denominator } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_one_inside_and_a_tenth_at_the_margin() {
        for f in [long_tail_reward, gaussian_reward] {
            assert_eq!(f(0.05, 0.05, 0.2), 1.0);
            assert!((f(0.25, 0.05, 0.2) - 0.1).abs() < 1e-12);
            assert_eq!(f(0.06, 0.05, 0.0), 0.0);
        }
    }

    #[test]
    fn a_value_between_its_bounds_earns_one_and_either_side_decays_alike() {
        let reward = |value| long_tail_interval_reward(value, [0.25, 0.5], 0.5);
        assert_eq!([0.25, 0.3, 0.5].map(reward), [1.0; 3]);
        assert_eq!([-0.25, 1.0].map(reward), [0.1; 2]);
    }

    #[test]
    fn hamacher_has_one_as_unit_and_zero_as_absorber() {
        assert_eq!(hamacher_product(0.3, 1.0), 0.3);
        assert_eq!(hamacher_product(0.0, 0.7), 0.0);
        assert_eq!(hamacher_product(0.0, 0.0), 0.0);
        assert!((hamacher_product(0.5, 0.5) - 1.0 / 3.0).abs() < 1e-15);
    }
}

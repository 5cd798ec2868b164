//! Metric properties of the distance on random clouds.

use cluster::{MAX_COST, wasserstein1};
use proptest::prelude::*;

use crate::common::uniform;

const DIM: usize = 3;

fn cloud() -> impl Strategy<Value = Vec<f32>> {
    // quarters: differences and translations are exact in f32, and ties are common
    let coordinate = (-40i16..40).prop_map(|q| f32::from(q) / 4.0);
    let points = prop::collection::vec(prop::array::uniform3(coordinate), 1..14);
    points.prop_map(|points| points.concat())
}

fn translation() -> impl Strategy<Value = [f32; DIM]> {
    prop::array::uniform3(-8i16..8).prop_map(|t| t.map(f32::from))
}

/// Mean of coordinate `d` over the points of `cloud`.
fn mean(cloud: &[f32], d: usize) -> f64 {
    let values = cloud.iter().skip(d).step_by(DIM);
    values.map(|&v| f64::from(v)).sum::<f64>() * DIM as f64 / cloud.len() as f64
}

fn shifted(x: &[f32], t: &[f32; DIM]) -> Vec<f32> {
    x.chunks_exact(DIM).flat_map(|p| [p[0] + t[0], p[1] + t[1], p[2] + t[2]]).collect()
}

fn w1(x: &[f32], y: &[f32]) -> f64 {
    wasserstein1(x, y, DIM).expect("finite clouds of whole points")
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(200)
    })]

    #[test]
    fn is_symmetric(x in cloud(), y in cloud()) {
        prop_assert!((w1(&x, &y) - w1(&y, &x)).abs() < 1e-9);
    }

    #[test]
    fn is_zero_from_a_cloud_to_itself_reordered(x in cloud()) {
        let mut points: Vec<&[f32]> = x.chunks_exact(DIM).collect();
        points.reverse();
        prop_assert!(w1(&x, &points.concat()).abs() < 1e-9);
    }

    #[test]
    fn obeys_the_triangle_inequality(x in cloud(), y in cloud(), z in cloud()) {
        prop_assert!(w1(&x, &z) <= w1(&x, &y) + w1(&y, &z) + 1e-9);
    }

    #[test]
    fn a_translation_costs_its_length(x in cloud(), t in translation()) {
        let length = t.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
        prop_assert!((w1(&x, &shifted(&x, &t)) - length).abs() < 1e-9 * length.max(1.0));
    }

    #[test]
    fn moving_both_clouds_changes_nothing(x in cloud(), y in cloud(), t in translation()) {
        prop_assert!((w1(&x, &y) - w1(&shifted(&x, &t), &shifted(&y, &t))).abs() < 1e-9);
    }

    #[test]
    fn duplicating_a_cloud_changes_nothing(x in cloud(), y in cloud(), times in 1usize..4) {
        prop_assert!((w1(&x, &y) - w1(&x.repeat(times), &y)).abs() < 1e-9);
    }

    #[test]
    fn one_point_pays_the_mean_distance(p in translation(), y in cloud()) {
        let square = |(a, b): (&f32, f32)| f64::from(a - b).powi(2);
        let far = |q: &[f32]| q.iter().zip(p).map(square).sum::<f64>().sqrt();
        let mean = y.chunks_exact(DIM).map(far).sum::<f64>() / (y.len() / DIM) as f64;
        prop_assert!((w1(&p, &y) - mean).abs() < 1e-9);
    }

    #[test]
    fn is_at_least_the_distance_of_the_means(x in cloud(), y in cloud()) {
        let apart = (0..DIM).map(|d| (mean(&x, d) - mean(&y, d)).powi(2)).sum::<f64>().sqrt();
        prop_assert!(w1(&x, &y) >= apart - 1e-9);
    }

    #[test]
    fn a_far_point_in_both_clouds_changes_nothing(
        mut x in cloud(),
        mut y in cloud(),
        exponent in 2i32..31,
    ) {
        let points = x.len().min(y.len()) / DIM;
        x.truncate(points * DIM);
        y.truncate(points * DIM);
        let expected = w1(&x, &y) * points as f64 / (points + 1) as f64;
        x.extend([10.0_f32.powi(exponent); DIM]);
        y.extend([10.0_f32.powi(exponent); DIM]);
        prop_assert!((w1(&x, &y) - expected).abs() <= 1e-9 * expected);
    }

    #[test]
    fn costs_that_only_forbid_a_pair_may_be_any(
        n in 2usize..12,
        drawn in prop::collection::vec((0u8..40, any::<bool>()), 144),
        exponent in 4i32..100,
    ) {
        // a plan within the pairs allowed, the diagonal, costs less than any with another pair
        let value = |forbidden: f64| {
            let cost: Vec<f64> = (0..n * n)
                .map(|k| match drawn[k] {
                    (quarters, allowed) if allowed || k / n == k % n => f64::from(quarters) / 4.0,
                    _ => forbidden,
                })
                .collect();
            uniform(&cost, n, n).expect("finite costs").cost
        };
        let expected = value(1e3);
        for forbidden in [10.0_f64.powi(exponent), MAX_COST] {
            prop_assert!((value(forbidden) - expected).abs() <= 1e-9 * expected);
        }
    }
}

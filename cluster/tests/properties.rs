//! Properties of transport between measures of equal and of given weights.

use cluster::{PointWeights, TransportPlan, WassersteinSolver, wasserstein1};
use proptest::prelude::*;

use crate::common::{self, random_costs};

const DIM: usize = 3;

/// Points with weights of sum one; `None` for equal weights.
#[derive(Clone, Debug)]
struct Measure {
    points: Vec<[f32; DIM]>,
    weights: Option<Vec<f64>>,
}

impl Measure {
    fn weights(&self) -> PointWeights<'_> {
        let equal = PointWeights::Uniform(self.points.len());
        self.weights.as_deref().map_or(equal, PointWeights::Given)
    }

    /// Weights of all points, as numbers.
    fn shares(&self) -> Vec<f64> {
        let n = self.points.len();
        self.weights.clone().unwrap_or(vec![1.0 / n as f64; n])
    }

    fn shifted(&self, t: &[f32; DIM]) -> Self {
        let points = self.points.iter().map(|p| [p[0] + t[0], p[1] + t[1], p[2] + t[2]]);
        Self { points: points.collect(), weights: self.weights.clone() }
    }

    /// Replaces each point by `times` copies, which share its weight.
    fn copied(&self, times: usize) -> Self {
        let parts = |weights: &Vec<f64>| {
            let part: Vec<f64> = weights.iter().map(|w| w / times as f64).collect();
            part.repeat(times)
        };
        Self { points: self.points.repeat(times), weights: self.weights.as_ref().map(parts) }
    }

    fn mean(&self, d: usize) -> f64 {
        self.points.iter().zip(self.shares()).map(|(p, w)| f64::from(p[d]) * w).sum()
    }
}

fn measure() -> impl Strategy<Value = Measure> {
    // quarters: translations are exact in f32, and ties, duplicates and weights of zero are common
    let coordinate = (-8i8..8).prop_map(|q| f32::from(q) / 4.0);
    let points = prop::collection::vec((prop::array::uniform3(coordinate), 0u8..5), 1..14);
    (points, any::<bool>()).prop_map(|(mut points, equal)| {
        points[0].1 += 1;
        let sum: f64 = points.iter().map(|(_, count)| f64::from(*count)).sum();
        let weights = points.iter().map(|(_, count)| f64::from(*count) / sum).collect();
        let points = points.into_iter().map(|(point, _)| point).collect();
        Measure { points, weights: (!equal).then_some(weights) }
    })
}

fn translation() -> impl Strategy<Value = [f32; DIM]> {
    prop::array::uniform3(-8i8..8).prop_map(|t| t.map(f32::from))
}

fn plan(x: &Measure, y: &Measure) -> TransportPlan {
    let (from, to) = (x.points.as_flattened(), y.points.as_flattened());
    let mut workspace = WassersteinSolver::new();
    workspace.solve((from, x.weights()), (to, y.weights()), DIM).expect("two measures").clone()
}

fn w1(x: &Measure, y: &Measure) -> f64 {
    match (&x.weights, &y.weights) {
        (None, None) => wasserstein1(x.points.as_flattened(), y.points.as_flattened(), DIM)
            .expect("finite clouds of whole points"),
        _ => plan(x, y).cost,
    }
}

fn distance(p: &[f32; DIM], q: &[f32; DIM]) -> f64 {
    let squares = p.iter().zip(q).map(|(a, b)| f64::from(a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(500)
    })]

    #[test]
    fn is_a_metric(x in measure(), y in measure(), z in measure()) {
        let mut reordered = x.clone();
        reordered.points.reverse();
        reordered.weights.iter_mut().for_each(|weights| weights.reverse());
        prop_assert!(w1(&x, &reordered).abs() < 1e-12);
        prop_assert!((w1(&x, &y) - w1(&y, &x)).abs() < 1e-12);
        prop_assert!(w1(&x, &z) <= w1(&x, &y) + w1(&y, &z) + 1e-12);
    }

    #[test]
    fn a_translation_costs_its_length(x in measure(), t in translation()) {
        prop_assert!((w1(&x, &x.shifted(&t)) - distance(&t, &[0.0; DIM])).abs() < 1e-12);
    }

    #[test]
    fn moving_both_measures_changes_nothing(x in measure(), y in measure(), t in translation()) {
        prop_assert!((w1(&x, &y) - w1(&x.shifted(&t), &y.shifted(&t))).abs() < 1e-12);
    }

    #[test]
    fn splitting_points_changes_nothing(x in measure(), y in measure(), times in 1usize..4) {
        let whole = w1(&x, &y);
        prop_assert!((whole - w1(&x.copied(times), &y)).abs() < 1e-12);
        prop_assert!((whole - w1(&x.copied(times), &y.copied(times))).abs() < 1e-12);
        prop_assert!(w1(&x, &x.copied(times)).abs() < 1e-12);
    }

    #[test]
    fn points_without_weight_change_nothing(x in measure(), y in measure()) {
        let (points, weights): (Vec<_>, Vec<_>) =
            x.points.iter().copied().zip(x.shares()).filter(|(_, w)| *w > 0.0).unzip();
        let kept = Measure { points, weights: Some(weights) };
        prop_assert!((w1(&x, &y) - w1(&kept, &y)).abs() < 1e-12);
    }

    #[test]
    fn is_at_least_the_distance_of_the_means(x in measure(), y in measure()) {
        let apart = (0..DIM).map(|d| (x.mean(d) - y.mean(d)).powi(2)).sum::<f64>().sqrt();
        prop_assert!(w1(&x, &y) >= apart - 1e-12);
    }

    #[test]
    fn plan_and_potentials_prove_each_other(x in measure(), y in measure()) {
        // by the definitions, not by the crate's certificate
        let plan = plan(&x, &y);
        let (u, v) = (&plan.source_potentials, &plan.sink_potentials);
        let mut sent = vec![0.0; x.points.len()];
        let mut received = vec![0.0; y.points.len()];
        let mut paid = 0.0;
        for e in &plan.entries {
            prop_assert!(e.mass > 0.0);
            sent[e.source] += e.mass;
            received[e.sink] += e.mass;
            paid += e.mass * distance(&x.points[e.source], &y.points[e.sink]);
        }
        let (a, b) = (x.shares(), y.shares());
        for (got, expected) in sent.iter().chain(&received).zip(a.iter().chain(&b)) {
            prop_assert!((got - expected).abs() < 1e-14);
        }
        for (p, source) in x.points.iter().zip(u) {
            for (q, sink) in y.points.iter().zip(v) {
                prop_assert!(source + sink <= distance(p, q) + 1e-13);
            }
        }
        let worth = |w: &[f64], potentials: &[f64]| -> f64 {
            w.iter().zip(potentials).map(|(w, p)| w * p).sum()
        };
        let dual = worth(&a, u) + worth(&b, v);
        prop_assert!((paid - dual).abs() < 1e-13 && (paid - plan.cost).abs() < 1e-13);
        prop_assert!(plan.entries.len() < x.points.len() + y.points.len());
    }

    #[test]
    fn powers_of_two_scale_every_bit(x in measure(), y in measure(), exponent in -40i32..40) {
        let scale = 2.0_f32.powi(exponent);
        let scaled = |measure: &Measure| {
            let mut scaled = measure.clone();
            scaled.points.as_flattened_mut().iter_mut().for_each(|c| *c *= scale);
            scaled
        };
        let scaled = plan(&scaled(&x), &scaled(&y));
        let plan = plan(&x, &y);
        prop_assert_eq!(scaled.cost, plan.cost * f64::from(scale));
        prop_assert_eq!(scaled.pivots, plan.pivots);
        prop_assert_eq!(scaled.entries, plan.entries);
    }

}

#[test]
fn powers_of_two_scale_the_bits_of_a_priced_shortlist() {
    let (n, m) = (40, 600);
    let cost = random_costs(1, n * m);
    let scaled: Vec<f64> = cost.iter().map(|c| c * 2.0_f64.powi(-60)).collect();
    let plan = common::uniform(&cost, n, m).unwrap();
    let small = common::uniform(&scaled, n, m).unwrap();
    assert_eq!(small.entries, plan.entries);
    assert_eq!(small.cost, plan.cost * 2.0_f64.powi(-60));
}

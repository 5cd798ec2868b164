//! Properties of transport between weighted measures.

use cluster::{Solver, TransportPlan, Wasserstein, Weights, transport};
use proptest::prelude::*;

use crate::common::{self, random_costs};

const DIM: usize = 3;

/// Points with weights of sum one.
#[derive(Clone, Debug)]
struct Measure {
    points: Vec<[f32; DIM]>,
    weights: Vec<f64>,
}

fn measure() -> impl Strategy<Value = Measure> {
    // quarters: translations are exact in f32, and ties, duplicates and weights of zero are common
    let coordinate = (-8i8..8).prop_map(|q| f32::from(q) / 4.0);
    let points = prop::collection::vec((prop::array::uniform3(coordinate), 0u8..5), 1..14);
    points.prop_map(|mut points| {
        points[0].1 += 1;
        let sum: f64 = points.iter().map(|(_, count)| f64::from(*count)).sum();
        Measure {
            weights: points.iter().map(|(_, count)| f64::from(*count) / sum).collect(),
            points: points.into_iter().map(|(point, _)| point).collect(),
        }
    })
}

fn plan(x: &Measure, y: &Measure) -> TransportPlan {
    let (a, b) = (Weights::Given(&x.weights), Weights::Given(&y.weights));
    let (from, to) = (x.points.as_flattened(), y.points.as_flattened());
    let mut workspace = Wasserstein::new();
    workspace.solve((from, a), (to, b), DIM).expect("two measures").clone()
}

fn w1(x: &Measure, y: &Measure) -> f64 {
    plan(x, y).cost
}

fn distance(p: &[f32; DIM], q: &[f32; DIM]) -> f64 {
    let squares = p.iter().zip(q).map(|(a, b)| f64::from(a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Moves half of each point's weight to a copy at the end.
fn halved(x: &Measure) -> Measure {
    let halves: Vec<f64> = x.weights.iter().map(|w| w / 2.0).collect();
    Measure { points: x.points.repeat(2), weights: halves.repeat(2) }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(300)
    })]

    #[test]
    fn is_a_metric(x in measure(), y in measure(), z in measure()) {
        prop_assert!(w1(&x, &x).abs() < 1e-12);
        prop_assert!((w1(&x, &y) - w1(&y, &x)).abs() < 1e-12);
        prop_assert!(w1(&x, &z) <= w1(&x, &y) + w1(&y, &z) + 1e-12);
    }

    #[test]
    fn a_translation_costs_its_length(x in measure(), t in prop::array::uniform3(-8i8..8)) {
        let t = t.map(f32::from);
        let mut moved = x.clone();
        moved.points.iter_mut().for_each(|p| *p = [p[0] + t[0], p[1] + t[1], p[2] + t[2]]);
        prop_assert!((w1(&x, &moved) - distance(&t, &[0.0; DIM])).abs() < 1e-12);
    }

    #[test]
    fn splitting_points_changes_nothing(x in measure(), y in measure()) {
        let whole = w1(&x, &y);
        prop_assert!((whole - w1(&halved(&x), &y)).abs() < 1e-12);
        prop_assert!((whole - w1(&halved(&x), &halved(&y))).abs() < 1e-12);
        prop_assert!(w1(&x, &halved(&x)).abs() < 1e-12);
    }

    #[test]
    fn points_without_weight_change_nothing(x in measure(), y in measure()) {
        let mut kept = x.clone();
        let pairs = x.points.iter().zip(&x.weights);
        kept.points = pairs.filter(|(_, w)| **w > 0.0).map(|(p, _)| *p).collect();
        kept.weights.retain(|w| *w > 0.0);
        prop_assert!((w1(&x, &y) - w1(&kept, &y)).abs() < 1e-12);
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
        let weights = x.weights.iter().chain(&y.weights);
        for (got, expected) in sent.iter().chain(&received).zip(weights) {
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
        let dual = worth(&x.weights, u) + worth(&y.weights, v);
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

    #[test]
    fn a_warm_start_follows_any_growth_and_shrinkage(
        seed in 0u64..1000,
        steps in prop::collection::vec(
            (1usize..25, 1usize..25, any::<bool>(), any::<bool>()),
            1..12,
        ),
    ) {
        // point i and point j keep their cost; weights change between equal and increasing
        let all = random_costs(seed, 25 * 25);
        let mut solver = Solver::new();
        for (n, m, rising, tied) in steps {
            let cost: Vec<f64> = (0..n * m)
                .map(|k| all[k / m * 25 + k % m])
                .map(|c| if tied { (2.0 * c).round() } else { c })
                .collect();
            let sum = (n * (n + 1) / 2) as f64;
            let weights: Vec<f64> = (1..=n).map(|i| i as f64 / sum).collect();
            let sources = if rising { Weights::Given(&weights) } else { Weights::Uniform(n) };
            let warm = solver.solve_again(&cost, sources, Weights::Uniform(m)).unwrap().cost;
            let cold = transport(&cost, sources, Weights::Uniform(m)).unwrap().cost;
            prop_assert!((warm - cold).abs() < 1e-13, "{warm} and {cold}");
        }
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

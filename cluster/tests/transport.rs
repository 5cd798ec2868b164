//! The solver on cost matrices.

use cluster::{PointWeights, TransportSolver, solve_transport};

use crate::common::{random_costs, uniform};

#[test]
fn solves_a_problem_worked_by_hand() {
    // source 0 is dear everywhere but at sink 1; sink 0 then takes source 1 although (1, 1) is
    // cheaper
    let plan = uniform(&[9.0, 2.0, 4.0, 1.0], 2, 2).unwrap();
    assert_eq!(plan.cost, 3.0);
    let pairs: Vec<_> = plan.entries.iter().map(|e| (e.source, e.sink, e.mass)).collect();
    assert_eq!(pairs, [(0, 1, 0.5), (1, 0, 0.5)]);
}

#[test]
fn a_reused_solver_gives_the_bits_of_a_new_one() {
    let mut solver = TransportSolver::new();
    for (n, m) in [(20, 30), (7, 600), (20, 30), (1, 1)] {
        let cost = random_costs(23, n * m);
        let reused =
            solver.solve(&cost, PointWeights::Uniform(n), PointWeights::Uniform(m)).unwrap();
        assert_eq!(*reused, uniform(&cost, n, m).unwrap());
    }
}

#[test]
fn weights_may_be_zero_or_very_small() {
    let weights = [0.0, 1e-300, 0.25, 0.0, 0.75];
    let cost = random_costs(25, 25);
    let plan = solve_transport(&cost, PointWeights::Given(&weights), PointWeights::Given(&weights))
        .unwrap();
    let sends = |point: usize| plan.entries.iter().filter(move |e| e.source == point);
    assert_eq!(sends(0).count() + sends(1).count() + sends(3).count(), 0);
    assert_eq!(sends(4).map(|e| e.mass).sum::<f64>(), 0.75);
}

#[test]
fn weights_of_single_precision_are_divided_by_their_sum() {
    let softmax = |len: usize| -> Vec<f64> {
        let logits = random_costs(26, len);
        let exps: Vec<f32> = logits.iter().map(|c| (4.0 * *c as f32).exp()).collect();
        let sum: f32 = exps.iter().sum();
        exps.iter().map(|e| f64::from(e / sum)).collect()
    };
    for weights in [vec![f64::from(0.2_f32); 5], softmax(30), softmax(1000)] {
        let n = weights.len();
        let sum: f64 = weights.iter().sum();
        assert!((sum - 1.0).abs() > 1e-9, "{n}: {sum}");
        let divided: Vec<f64> = weights.iter().map(|w| w / sum).collect();
        let cost: Vec<f64> = random_costs(27, 3 * n).iter().map(|c| 2.0 + c).collect();
        let solve = |w: &[f64]| {
            solve_transport(&cost, PointWeights::Given(w), PointWeights::Uniform(3)).unwrap()
        };
        let (got, expected) = (solve(&weights).cost, solve(&divided).cost);
        assert!((got / expected - 1.0).abs() < 1e-14, "{n}: {got} {expected}");
    }
}

#[test]
fn malformed_problems_are_refused_with_their_values() {
    let cases: [(&[f64], usize, usize, &str); 7] = [
        (&[], 0, 3, "sources is 0: expected at least 1"),
        (&[], 3, 0, "sinks is 0: expected at least 1"),
        (&[1.0; 5], 2, 3, "cost has 5 entries: expected sources x sinks = 2 x 3"),
        (&[1.0], usize::MAX, 2, "cost has 1 entries"),
        (&[1.0, f64::NAN], 1, 2, "cost[1] is NaN: expected a finite number"),
        (&[f64::INFINITY], 1, 1, "cost[0] is inf: expected a finite number"),
        (&[-1e200], 1, 1, "cost[0] is -1e200: expected at most 1e100"),
    ];
    for (cost, n, m, expected) in cases {
        let message = uniform(cost, n, m).unwrap_err().to_string();
        assert!(message.starts_with(expected), "{message}");
    }
    let of_weights: [(&[f64], &str); 6] = [
        (
            &[0.5, 0.25],
            "the weights of sources add up to 0.75, those of sinks to 1: expected 1 within 1e-6 \
             for both; divide the weights of each side by their sum",
        ),
        (&[1.5, -0.5], "sources[1] is -0.5: expected a finite number, at least 0"),
        (&[f64::NAN], "sources[0] is NaN"),
        (&[f64::INFINITY], "sources[0] is inf"),
        (&[], "sources is 0: expected at least 1"),
        (&[0.0, 0.0], "the weights of sources add up to 0,"),
    ];
    for (weights, expected) in of_weights {
        let (cost, sides) =
            (vec![0.0; weights.len()], (PointWeights::Given(weights), PointWeights::Uniform(1)));
        let message = solve_transport(&cost, sides.0, sides.1).unwrap_err().to_string();
        assert!(message.starts_with(expected), "{message}");
    }
}

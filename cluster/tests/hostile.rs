//! Input that somebody's bug or malice made: a clear error or a certified answer, never a panic.

use std::cmp::Ordering;

use cluster::{
    ClusterError, EuclideanCosts, MAX_COST, TransportPlan, Wasserstein, Weights, certify,
    transport, wasserstein1_line,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::common::{normals, random_costs, uniform};

fn solved(x: &[f32], a: Weights, y: &[f32], b: Weights, dim: usize) -> Result<f64, ClusterError> {
    Ok(Wasserstein::new().solve((x, a), (y, b), dim)?.cost)
}

#[test]
fn miscounted_weights_are_refused_even_where_the_matrix_has_the_right_length() {
    // two points and three, weighted as three and two: 2 x 3 = 3 x 2
    let (x, y) = ([0.0, 1.0], [0.0, 1.0, 2.0]);
    let error = solved(&x, Weights::Uniform(3), &y, Weights::Uniform(2), 1).unwrap_err();
    assert_eq!(
        error.to_string(),
        "x has 2 points and 3 weights: expected a weight for each point"
    );
    let error = wasserstein1_line(&x, Weights::Uniform(2), &y, Weights::Given(&[1.0]));
    let counts = ClusterError::WeightCount {
        side: "y",
        points: 3,
        weights: 1,
    };
    assert_eq!(error.unwrap_err(), counts);
}

#[test]
fn absurd_numbers_of_points_overflow_nothing() {
    for absurd in [usize::MAX, usize::MAX / 2, 1 << 32, u32::MAX as usize] {
        for other in [1, 2, 3, usize::MAX] {
            let (a, b) = (Weights::Uniform(absurd), Weights::Uniform(other));
            for (a, b) in [(a, b), (b, a)] {
                assert!(matches!(
                    transport(&[1.0], a, b),
                    Err(ClusterError::CostShape { .. })
                ));
                assert!(matches!(
                    certify(&[1.0], a, b, &TransportPlan::default()),
                    Err(ClusterError::CostShape { .. })
                ));
                for error in [
                    solved(&[1.0], a, &[1.0], b, 1),
                    wasserstein1_line(&[1.0], a, &[1.0], b),
                ] {
                    assert!(matches!(error, Err(ClusterError::WeightCount { .. })));
                }
            }
        }
    }
    assert!(matches!(
        EuclideanCosts::new().compute(&[1.0], &[1.0], usize::MAX),
        Err(ClusterError::Ragged { .. })
    ));
}

#[test]
fn a_matrix_that_no_memory_holds_is_refused() {
    let points = vec![0.0; 1 << 24];
    assert_eq!(
        EuclideanCosts::new()
            .compute(&points, &points, 1)
            .unwrap_err()
            .to_string(),
        "the distances between 16777216 and 16777216 points do not fit in memory; \
         compare samples of the clouds"
    );
}

#[test]
fn coprime_sizes_keep_their_units_exact() {
    // the least common multiple is 4001 x 3999
    let cost: Vec<f64> = (0..4001).map(f64::from).collect();
    assert_eq!(uniform(&cost, 1, 4001).unwrap().cost, 2000.0);
    let plan = uniform(&random_costs(1, 401 * 399), 401, 399).unwrap();
    assert!(plan.certificate.marginal_error < 1e-17);
}

#[test]
fn an_infinite_cost_does_not_make_the_certificate_generous() {
    let cost = [0.0, 5.0, 5.0, 0.0];
    let sides = (Weights::Uniform(2), Weights::Uniform(2));
    let mut plan = transport(&cost, sides.0, sides.1).unwrap();
    // the dearer matching, its cost infinite
    plan.entries.iter_mut().for_each(|e| e.sink = 1 - e.sink);
    plan.cost = f64::INFINITY;
    for unfit in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
        let error = certify(&[0.0, unfit, 5.0, 0.0], sides.0, sides.1, &plan).unwrap_err();
        assert!(matches!(
            error,
            ClusterError::NonFinite {
                what: "cost",
                index: 1,
                ..
            }
        ));
    }
    let error = certify(&[0.0, 2.0 * MAX_COST, 5.0, 0.0], sides.0, sides.1, &plan).unwrap_err();
    assert!(matches!(error, ClusterError::CostTooLarge { index: 1, .. }));
}

#[test]
fn subnormal_costs_are_certified() {
    let last_bit = f64::from_bits(1);
    assert_eq!(uniform(&[last_bit; 9], 3, 3).unwrap().cost, last_bit);
    for scale in [1e-310, 1e-318, 1e-323] {
        let cost: Vec<f64> = random_costs(3, 400).iter().map(|c| c * scale).collect();
        uniform(&cost, 20, 20).unwrap();
    }
}

#[test]
fn every_scale_in_one_matrix_is_certified() {
    for n in [10, 100, 300] {
        let random = random_costs(4, n * n);
        let cost: Vec<f64> = random.iter().map(|c| 10_f64.powf(30.0 * c)).collect();
        uniform(&cost, n, n).unwrap();
        let signed: Vec<f64> = random
            .iter()
            .map(|c| c.signum() * 10_f64.powf(30.0 * c))
            .collect();
        uniform(&signed, n, n).unwrap();
    }
}

#[test]
fn ties_and_the_largest_costs_end_within_the_bound_on_pivots() {
    let n = 200;
    for levels in [1.0, 2.0, 10.0] {
        // tenths: sums along a path round
        let tied: Vec<f64> = random_costs(5, n * n)
            .iter()
            .map(|c| (levels * c).round() * 0.1)
            .collect();
        uniform(&tied, n, n).unwrap();
        uniform(&tied[..n * 7], n, 7).unwrap();
    }
    let grid: Vec<f64> = (0..n * n)
        .map(|k| (k / n).abs_diff(k % n) as f64 * 0.1)
        .collect();
    assert!(uniform(&grid, n, n).unwrap().cost.abs() < 1e-12);
    for cost in [[MAX_COST; 40], [-MAX_COST; 40]] {
        assert_eq!(uniform(&cost, 5, 8).unwrap().cost, cost[0]);
    }
    let extremes: Vec<f64> = random_costs(6, n * n)
        .iter()
        .map(|c| MAX_COST * c.signum())
        .collect();
    uniform(&extremes, n, n).unwrap();
}

#[test]
fn weights_at_the_edge_of_a_distribution() {
    let cost = random_costs(7, 9);
    let solve = |weights: &[f64]| transport(&cost, Weights::Given(weights), Weights::Uniform(3));
    solve(&[0.5, 0.5 + 0.9e-9, 0.0]).unwrap();
    let message = solve(&[0.5, 0.5 + 1.1e-9, 0.0]).unwrap_err().to_string();
    assert!(message.contains("add up to 1.0000000011"), "{message}");
    solve(&[1.0, -0.0, f64::from_bits(1)]).unwrap();
    let many = vec![1e-4; 10_000];
    let far: Vec<f64> = (0..10_000).map(f64::from).collect();
    let plan = transport(&far, Weights::Given(&many), Weights::Uniform(1)).unwrap();
    assert!((plan.cost - 4999.5).abs() < 1e-9);
}

#[test]
fn forbidden_pairs_take_no_precision_from_the_others() {
    // on and below the diagonal some pairs are dear, above it most are
    let n = 60;
    let (mut cost, coin) = (random_costs(3, n * n), random_costs(4, n * n));
    let forbidden = |k: &usize| match (k / n).cmp(&(k % n)) {
        Ordering::Less => coin[*k] > -0.8,
        Ordering::Equal => false,
        Ordering::Greater => coin[*k] > 0.8,
    };
    let forbidden: Vec<usize> = (0..n * n).filter(forbidden).collect();
    let mut value = |dear: f64| {
        forbidden.iter().for_each(|&k| cost[k] = dear);
        uniform(&cost, n, n).unwrap().cost
    };
    let expected = value(100.0);
    for dear in [1e6, 1e12, 1e18, 1e30, MAX_COST] {
        let got = value(dear);
        assert!((got - expected).abs() < 1e-14, "{dear:e}: {got}");
    }
}

#[test]
fn a_far_point_costs_no_more_precision_than_the_certificate_admits() {
    let n = 100;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut x, mut y) = (normals(&mut rng, 2 * n), normals(&mut rng, 2 * n));
    let near = solved(&x, Weights::Uniform(n), &y, Weights::Uniform(n), 2).unwrap();
    let expected = near * n as f64 / (n + 1) as f64;
    // one point of each cloud, in the same place
    x.extend([0.0; 2]);
    y.extend([0.0; 2]);
    for far in [1e4, 1e8, 1e12, 1e16] {
        x[2 * n..].fill(far);
        y[2 * n..].fill(far);
        let mut workspace = Wasserstein::new();
        let weights = Weights::Uniform(n + 1);
        let plan = workspace.solve((&x, weights), (&y, weights), 2).unwrap();
        let error = plan.cost - expected;
        let admitted = plan.certificate.gap + plan.certificate.violation + 1e-15;
        assert!(error.abs() <= admitted, "{far:e}: {error:e} {admitted:e}");
    }
}

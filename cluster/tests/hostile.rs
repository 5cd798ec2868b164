//! Input that somebody's bug or malice made: a clear error or a certified answer, never a panic.

use cluster::{
    ClusterError, EuclideanDistances, MAX_ABS_COST, OptimalityCertificate, PointWeights,
    TransportPlan, TransportPlanEntry, WassersteinSolver, certify_optimality, solve_transport,
    wasserstein1,
};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::common::{normals, random_costs, uniform};

fn solved(
    x: &[f32],
    a: PointWeights,
    y: &[f32],
    b: PointWeights,
    dim: usize,
) -> Result<f64, ClusterError> {
    Ok(WassersteinSolver::new().solve((x, a), (y, b), dim)?.cost)
}

#[test]
fn miscounted_weights_are_refused_even_where_the_matrix_has_the_right_length() {
    // two points and three, weighted as three and two: 2 x 3 = 3 x 2
    let (x, y) = ([0.0, 1.0], [0.0, 1.0, 2.0]);
    let error = solved(&x, PointWeights::Uniform(3), &y, PointWeights::Uniform(2), 1).unwrap_err();
    assert_eq!(error.to_string(), "weights of x has length 3: expected 2");
}

#[test]
fn absurd_numbers_of_points_overflow_nothing() {
    for absurd in [usize::MAX, usize::MAX / 2, 1 << 32, u32::MAX as usize] {
        for other in [1, 2, 3, usize::MAX] {
            let (a, b) = (PointWeights::Uniform(absurd), PointWeights::Uniform(other));
            for (from, to) in [(a, b), (b, a)] {
                let plan = TransportPlan::default();
                assert!(matches!(
                    solve_transport(&[1.0], from, to),
                    Err(ClusterError::CostShape { .. })
                ));
                let certified = certify_optimality(&[1.0], from, to, &plan);
                assert!(matches!(certified, Err(ClusterError::CostShape { .. })));
                let error = solved(&[1.0], from, &[1.0], to, 1);
                assert!(matches!(error, Err(ClusterError::Length { .. })));
            }
        }
    }
    assert!(matches!(
        EuclideanDistances::new().compute(&[1.0], &[1.0], usize::MAX),
        Err(ClusterError::Ragged { .. })
    ));
}

#[test]
fn a_matrix_that_no_memory_holds_is_refused() {
    let points = vec![0.0; 1 << 24];
    assert_eq!(
        EuclideanDistances::new().compute(&points, &points, 1).unwrap_err().to_string(),
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
    let sides = (PointWeights::Uniform(2), PointWeights::Uniform(2));
    let mut plan = solve_transport(&cost, sides.0, sides.1).unwrap();
    // the dearer matching, its cost infinite
    plan.entries.iter_mut().for_each(|e| e.sink = 1 - e.sink);
    plan.cost = f64::INFINITY;
    for unfit in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
        let error =
            certify_optimality(&[0.0, unfit, 5.0, 0.0], sides.0, sides.1, &plan).unwrap_err();
        assert!(matches!(error, ClusterError::NonFinite { what: "cost", index: 1, .. }));
    }
    let error = certify_optimality(&[0.0, 2.0 * MAX_ABS_COST, 5.0, 0.0], sides.0, sides.1, &plan)
        .unwrap_err();
    assert!(matches!(error, ClusterError::CostTooLarge { index: 1, .. }));
}

#[test]
fn weights_at_the_edge_of_a_distribution() {
    let cost = random_costs(7, 9);
    let solve = |weights: &[f64]| {
        solve_transport(&cost, PointWeights::Given(weights), PointWeights::Uniform(3))
    };
    for off in [-0.9e-6, 0.9e-6] {
        solve(&[0.5, 0.5 + off, 0.0]).unwrap();
        let far = [0.5, 0.5 + off / 0.8, 0.0];
        let message = solve(&far).unwrap_err().to_string();
        let sums = format!("add up to {}, those of sinks to 1:", far.iter().sum::<f64>());
        assert!(message.contains(&sums), "{message}");
    }
    solve(&[1.0, -0.0, f64::from_bits(1)]).unwrap();
    let many = vec![1e-4; 10_000];
    let far: Vec<f64> = (0..10_000).map(f64::from).collect();
    let plan = solve_transport(&far, PointWeights::Given(&many), PointWeights::Uniform(1)).unwrap();
    assert!((plan.cost - 4999.5).abs() < 1e-9);
}

#[test]
fn costs_that_vanish_in_the_potentials_are_seen_by_the_certificate() {
    // potentials near the price of a forbidden pair round to the same number for each small cost
    for forbidden in [1e9, 1e16, 1e18, 1e30, 1e60, MAX_ABS_COST] {
        let f = forbidden;
        // by all six permutations
        let plan = uniform(&[3.0, 1.0, f, 1.0, 2.0, f, f, f, 5.0], 3, 3).unwrap();
        let OptimalityCertificate { gap, violation, .. } = plan.certificate;
        assert!((plan.cost - 7.0 / 3.0).abs() < 1e-14 && gap + violation < 1e-13, "{plan:?}");
        let three = [0.0, -1.0, f, -1.0, 0.0, f, f, f, 0.0];
        let got = uniform(&three, 3, 3).unwrap().cost;
        assert!((got + 2.0 / 3.0).abs() < 1e-12, "{f:e}: {got}");
        let four = [[-2.0, 1.0, f, f], [2.0, f, -2.0, f], [3.0, 1.0, f, f], [1.0, 0.0, 3.0, -2.0]];
        let reduced = uniform(four.as_flattened(), 4, 4).unwrap().cost;
        assert!((reduced + 1.25).abs() < 1e-12, "{f:e}: {reduced}");
    }
}

#[test]
fn a_plan_with_potentials_that_hide_its_costs_is_refused() {
    let diagonal = |n: usize, u: &[f64], v: &[f64]| TransportPlan {
        entries: (0..n)
            .map(|k| TransportPlanEntry { source: k, sink: k, mass: 1.0 / n as f64 })
            .collect(),
        source_potentials: u.to_vec(),
        sink_potentials: v.to_vec(),
        ..TransportPlan::default()
    };
    // the cost of the plan exceeds the optimum by 2/3; so large potentials make sums of zero
    for f in [1e18, 1e30, MAX_ABS_COST] {
        let cost = [0.0, -1.0, f, -1.0, 0.0, f, f, f, 0.0];
        let plan = diagonal(3, &[f, f, 0.0], &[-f, -f, 0.0]);
        let (three, weights) = (PointWeights::Uniform(3), [1.0 / 3.0; 3]);
        for sides in [(three, three), (PointWeights::Given(&weights), three)] {
            let error = certify_optimality(&cost, sides.0, sides.1, &plan).unwrap_err();
            assert!(matches!(error, ClusterError::Imprecise { .. }), "{error}");
        }
    }
    // potentials that overflow
    let (two, plan) = (PointWeights::Uniform(2), diagonal(2, &[f64::MAX, 0.0], &[f64::MAX, 0.0]));
    let error = certify_optimality(&[0.0; 4], two, two, &plan).unwrap_err();
    assert!(matches!(error, ClusterError::DualInfeasible { .. }), "{error}");
}

#[test]
fn clouds_that_differ_in_one_point_of_many_are_not_refused() {
    for (n, dim) in [(10, 2), (500, 1), (500, 2), (501, 3), (2000, 1), (2000, 2)] {
        for seed in 0..2 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let x = normals(&mut rng, n * dim);
            let mut order: Vec<usize> = (0..n).collect();
            order.shuffle(&mut rng);
            let points = order.iter().map(|i| &x[i * dim..][..dim]);
            let copy: Vec<f32> = points.flatten().copied().collect();
            assert_eq!(wasserstein1(&x, &copy, dim).unwrap(), 0.0);
            for step in [1e-4, 0.5 / n as f32, 4.0 / n as f32] {
                let mut y = copy.clone();
                y[..dim].iter_mut().for_each(|v| *v += step);
                let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
                let moved = y.iter().zip(&copy).map(square).sum::<f64>().sqrt();
                // all but one point stay, or a chain of points in between moves up
                let expected = moved / n as f64;
                let got = wasserstein1(&x, &y, dim).unwrap();
                let error = (got / expected - 1.0).abs();
                assert!(error < 1e-9, "{n}, {dim}, {seed}, {step}: {got} {expected}");
            }
        }
    }
}

#[test]
fn a_far_point_in_both_clouds_costs_no_precision() {
    for (n, dim) in [(20, 2), (100, 2), (20, 512), (600, 2)] {
        let mut rng = ChaCha8Rng::seed_from_u64(n as u64);
        let (mut x, mut y) = (normals(&mut rng, dim * n), normals(&mut rng, dim * n));
        let expected = wasserstein1(&x, &y, dim).unwrap() * n as f64 / (n + 1) as f64;
        x.extend(vec![0.0; dim]);
        y.extend(vec![0.0; dim]);
        for far in [1e4, 1e8, 1e12, 1e14, 1e15, 1e16, 1e18, 1e30] {
            x[dim * n..].fill(far);
            y[dim * n..].fill(far);
            let got = wasserstein1(&x, &y, dim).unwrap();
            let error = (got - expected).abs() / expected;
            assert!(error < 1e-10, "{n}, {dim}, {far:e}: {got} {expected}");
        }
    }
}

#[test]
fn a_far_point_in_one_cloud_is_the_whole_distance() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (mut x, y) = (normals(&mut rng, 40), normals(&mut rng, 42));
    x.extend([1e30, 0.0]);
    let distance = wasserstein1(&x, &y, 2).unwrap();
    assert!((distance / (1e30 / 21.0) - 1.0).abs() < 1e-7, "{distance}");
}

#[test]
fn near_copies_keep_the_digits_of_their_small_distance() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let x = normals(&mut rng, 200);
    let shift = 2.0_f32.powi(-22);
    // shifts that are exact, in the coarsest unit of the coordinates
    let x: Vec<f32> = x.iter().map(|v| (v / shift).round() * shift).collect();
    let y: Vec<f32> = x.iter().map(|v| v + shift).collect();
    let expected = f64::from(shift) * 2.0_f64.sqrt();
    let got = wasserstein1(&x, &y, 2).unwrap();
    assert!((got / expected - 1.0).abs() < 1e-10, "{got} {expected}");
    assert_eq!(wasserstein1(&x, &x, 2).unwrap(), 0.0);
}

#[test]
fn what_rounding_leaves_open_is_refused_and_never_returned() {
    // a weight of 1e-17 goes a way of 1e18, which is ten of a cost of eleven, and the potentials
    // that link it to the rest are no finer than 128
    let far = 1e18;
    let mut cost = random_costs(9, 400);
    cost.iter_mut().for_each(|c| *c += 2.0);
    cost[..20].fill(far);
    let mut weights = vec![1.0 / 19.0; 20];
    weights[0] = 1e-17;
    let error = solve_transport(&cost, PointWeights::Given(&weights), PointWeights::Uniform(20))
        .unwrap_err();
    let ClusterError::Imprecise { cost: total, excess, tolerance } = error else {
        panic!("{error}");
    };
    assert!(excess > tolerance && tolerance < 1e-8 * total, "{error}");
    let message = error.to_string();
    assert!(message.contains("may exceed the optimum by"), "{message}");
}

#[test]
fn given_weights_that_round_are_refused_where_they_decide() {
    // as integers, thirds of the whole differ by some units, which go all the way
    let thirds = PointWeights::Given(&[1.0 / 3.0; 3]);
    let result = solved(&[0.0, 0.5, 1e30], thirds, &[1e30, 0.1, 0.7], thirds, 1);
    assert!(matches!(result, Err(ClusterError::Imprecise { .. })), "{result:?}");
    let quarters = PointWeights::Given(&[0.25; 4]);
    let (x, y) = ([0.0, 0.25, 0.5, 1e30], [1e30, 0.1, 0.3, 0.7]);
    let expected = wasserstein1(&x[..3], &y[1..], 1).unwrap() * 3.0 / 4.0;
    let distance = solved(&x, quarters, &y, quarters, 1).unwrap();
    assert!((distance - expected).abs() < 1e-9, "{distance}");
}

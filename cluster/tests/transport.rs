//! The solver on cost matrices, and the certificate's power to refuse.

// lints know tests, but not the helpers that tests call
#![allow(clippy::expect_used)]

use cluster::{ClusterError, Entry, TransportPlan, certify, transport};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random_costs(seed: u64, len: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A solved problem to spoil: 6 sources, 4 sinks.
fn solved() -> (Vec<f64>, TransportPlan) {
    let cost = random_costs(5, 24);
    let plan = transport(&cost, 6, 4).expect("a well-formed problem");
    certify(&cost, &plan).expect("the solver's own answer");
    (cost, plan)
}

fn refusal(spoil: impl Fn(&mut TransportPlan)) -> ClusterError {
    let (cost, mut plan) = solved();
    spoil(&mut plan);
    certify(&cost, &plan).expect_err("a spoilt plan must be refused")
}

#[test]
fn certifies_random_problems_of_all_shapes() {
    for (n, m) in [
        (1, 1),
        (1, 50),
        (50, 1),
        (37, 23),
        (23, 37),
        (40, 40),
        (30, 45),
        (60, 20),
    ] {
        let plan = transport(&random_costs((n * m) as u64, n * m), n, m).unwrap();
        let mass: f64 = plan.entries.iter().map(|e| plan.mass(e)).sum();
        assert!((mass - 1.0).abs() < 1e-12);
        assert_eq!(
            (plan.source_potentials.len(), plan.sink_potentials.len()),
            (n, m)
        );
    }
}

#[test]
fn solves_a_problem_worked_by_hand() {
    // source 0 is dear everywhere but at sink 1; sink 0 then takes source 1 although (1, 1) is
    // cheaper
    let plan = transport(&[9.0, 2.0, 4.0, 1.0], 2, 2).unwrap();
    assert_eq!(plan.cost, 3.0);
    assert!(plan.entries.contains(&Entry {
        source: 0,
        sink: 1,
        units: 1
    }));
    assert!(plan.entries.contains(&Entry {
        source: 1,
        sink: 0,
        units: 1
    }));
}

#[test]
fn transposition_exchanges_the_sides() {
    let (n, m) = (7, 11);
    let cost = random_costs(9, n * m);
    let transposed: Vec<f64> = (0..n * m).map(|k| cost[(k % n) * m + k / n]).collect();
    let (a, b) = (
        transport(&cost, n, m).unwrap(),
        transport(&transposed, m, n).unwrap(),
    );
    assert!((a.cost - b.cost).abs() < 1e-12);
    certify(&transposed, &b).unwrap();
}

#[test]
fn extreme_scales_are_certified() {
    for scale in [1e-300, 1e-12, 1e12, 1e99] {
        let cost: Vec<f64> = random_costs(11, 20 * 12)
            .iter()
            .map(|c| c * scale)
            .collect();
        transport(&cost, 20, 12).unwrap();
    }
    assert_eq!(transport(&[0.0; 30], 5, 6).unwrap().cost, 0.0);
}

#[test]
fn costs_of_very_different_size_are_certified() {
    let cost: Vec<f64> = random_costs(12, 900)
        .iter()
        .map(|c| (40.0 * c).exp())
        .collect();
    transport(&cost, 30, 30).unwrap();
}

#[test]
fn malformed_matrices_are_refused() {
    let message = |cost: &[f64], n, m| transport(cost, n, m).unwrap_err().to_string();
    assert_eq!(message(&[], 0, 3), "sources is 0: expected at least 1");
    assert_eq!(message(&[], 3, 0), "sinks is 0: expected at least 1");
    assert_eq!(
        message(&[1.0; 5], 2, 3),
        "cost has 5 entries: expected sources x sinks = 2 x 3"
    );
    assert!(matches!(
        transport(&[1.0], usize::MAX, 2),
        Err(ClusterError::CostShape { .. })
    ));
    assert_eq!(
        message(&[1.0, f64::NAN], 1, 2),
        "cost[1] is NaN: expected a finite number"
    );
    assert_eq!(
        message(&[f64::INFINITY], 1, 1),
        "cost[0] is inf: expected a finite number"
    );
    assert!(message(&[-1e200], 1, 1).starts_with("cost[0] is -1e200: expected at most 1e100"));
}

#[test]
fn the_certificate_refuses_moved_mass() {
    let error = refusal(|plan| plan.entries[0].sink = (plan.entries[0].sink + 1) % 4);
    assert!(
        matches!(error, ClusterError::Marginal { side: "sink", .. }),
        "{error}"
    );
    let error = refusal(|plan| plan.entries[0].units += 1);
    assert!(
        matches!(error, ClusterError::Marginal { side: "source", .. }),
        "{error}"
    );
    let error = refusal(|plan| plan.entries.clear());
    assert!(
        matches!(error, ClusterError::Marginal { got: 0, .. }),
        "{error}"
    );
    let error = refusal(|plan| plan.entries[0].units = usize::MAX);
    assert!(matches!(error, ClusterError::Marginal { .. }), "{error}");
}

#[test]
fn the_certificate_refuses_a_feasible_plan_that_is_not_optimal() {
    // the dearer of the two matchings, with the potentials of the cheaper one
    let cost = [9.0, 2.0, 4.0, 1.0];
    let mut plan = transport(&cost, 2, 2).unwrap();
    plan.entries = vec![
        Entry {
            source: 0,
            sink: 0,
            units: 1,
        },
        Entry {
            source: 1,
            sink: 1,
            units: 1,
        },
    ];
    for claimed in [3.0, 5.0] {
        plan.cost = claimed;
        let error = certify(&cost, &plan).unwrap_err();
        assert!(
            matches!(error, ClusterError::DualityGap { primal: 5.0, .. }),
            "{error}"
        );
    }
}

#[test]
fn the_certificate_refuses_spoilt_potentials() {
    let error = refusal(|plan| plan.source_potentials[2] += 0.01);
    assert!(
        matches!(
            error,
            ClusterError::DualInfeasible {
                source_index: 2,
                ..
            }
        ),
        "{error}"
    );
    let error = refusal(|plan| plan.sink_potentials[1] -= 0.01);
    assert!(matches!(error, ClusterError::DualityGap { .. }), "{error}");
    let error = refusal(|plan| plan.sink_potentials[3] = f64::NAN);
    assert!(
        matches!(error, ClusterError::DualInfeasible { sink_index: 3, .. }),
        "{error}"
    );
    // opposite shifts cancel in the dual value but not in the reduced costs of a plan with mixed
    // pairs
    let error =
        refusal(|plan| (plan.source_potentials[0], plan.source_potentials[1]) = (1e6, -1e6));
    assert!(
        matches!(
            error,
            ClusterError::DualInfeasible {
                source_index: 0,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn the_certificate_refuses_false_claims_and_shapes() {
    let error = refusal(|plan| plan.cost += 0.01);
    assert!(matches!(error, ClusterError::DualityGap { .. }), "{error}");
    let error = refusal(|plan| plan.cost = f64::NAN);
    assert!(matches!(error, ClusterError::DualityGap { .. }), "{error}");
    let error = refusal(|plan| plan.sink_potentials.truncate(3));
    assert!(
        matches!(
            error,
            ClusterError::PlanShape {
                got: 3,
                expected: 4,
                ..
            }
        ),
        "{error}"
    );
    let error = refusal(|plan| plan.entries[0].source = 6);
    assert!(
        matches!(
            error,
            ClusterError::EntryOutOfRange {
                source_index: 6,
                ..
            }
        ),
        "{error}"
    );
    let error = refusal(|plan| (plan.sources, plan.sinks) = (4, 4));
    assert!(
        matches!(error, ClusterError::CostShape { len: 24, .. }),
        "{error}"
    );
}

//! The certificate's power to refuse.

use cluster::{ClusterError, Entry, TransportPlan, Weights, certify, transport};

use crate::common::{random_costs, uniform};

const SIDES: (Weights, Weights) = (Weights::Uniform(6), Weights::Uniform(4));

fn checked(cost: &[f64], plan: &TransportPlan) -> Result<cluster::Certificate, ClusterError> {
    certify(cost, SIDES.0, SIDES.1, plan)
}

/// A solved problem to spoil: 6 sources, 4 sinks.
fn solved() -> (Vec<f64>, TransportPlan) {
    let cost = random_costs(5, 24);
    let plan = uniform(&cost, 6, 4).expect("a well-formed problem");
    checked(&cost, &plan).expect("the solver's own answer");
    (cost, plan)
}

fn refusal(spoil: impl Fn(&mut TransportPlan)) -> ClusterError {
    let (cost, mut plan) = solved();
    spoil(&mut plan);
    checked(&cost, &plan).expect_err("a spoilt plan must be refused")
}

#[test]
fn the_certificate_refuses_moved_mass() {
    let error = refusal(|plan| plan.entries[0].sink = (plan.entries[0].sink + 1) % 4);
    assert!(matches!(error, ClusterError::Marginal { side: "sink", .. }), "{error}");
    let heavier = refusal(|plan| plan.entries[0].mass += 0.01);
    assert!(matches!(heavier, ClusterError::Marginal { side: "source", .. }), "{heavier}");
    let empty = refusal(|plan| plan.entries.clear());
    assert!(matches!(empty, ClusterError::Marginal { got: 0.0, .. }), "{empty}");
    let not_a_number = refusal(|plan| plan.entries[0].mass = f64::NAN);
    assert!(matches!(not_a_number, ClusterError::NegativeMass { .. }), "{not_a_number}");
    // a negative entry that its row and column make good
    let negative = refusal(|plan| {
        let moved = |sink, mass| Entry { source: 0, sink, mass };
        plan.entries.extend([moved(0, -0.01), moved(0, 0.01)]);
    });
    assert!(matches!(negative, ClusterError::NegativeMass { .. }), "{negative}");
}

#[test]
fn the_certificate_refuses_a_feasible_plan_that_is_not_optimal() {
    // the dearer of the two matchings, with the potentials of the cheaper one
    let cost = [9.0, 2.0, 4.0, 1.0];
    let sides = (Weights::Uniform(2), Weights::Uniform(2));
    let mut plan = transport(&cost, sides.0, sides.1).unwrap();
    plan.entries =
        vec![Entry { source: 0, sink: 0, mass: 0.5 }, Entry { source: 1, sink: 1, mass: 0.5 }];
    for claimed in [3.0, 5.0] {
        plan.cost = claimed;
        let error = certify(&cost, sides.0, sides.1, &plan).unwrap_err();
        assert!(matches!(error, ClusterError::DualityGap { primal: 5.0, .. }), "{error}");
    }
}

#[test]
fn the_certificate_refuses_spoilt_potentials() {
    let error = refusal(|plan| plan.source_potentials[2] += 0.01);
    assert!(matches!(error, ClusterError::DualInfeasible { source_index: 2, .. }), "{error}");
    let sink_moved = refusal(|plan| plan.sink_potentials[1] -= 0.01);
    assert!(matches!(sink_moved, ClusterError::DualityGap { .. }), "{sink_moved}");
    let nan_potential = refusal(|plan| plan.sink_potentials[3] = f64::NAN);
    assert!(
        matches!(nan_potential, ClusterError::DualInfeasible { sink_index: 3, .. }),
        "{nan_potential}"
    );
    // opposite shifts cancel in the dual value but not in the reduced costs of a plan with mixed
    // pairs
    let opposite =
        refusal(|plan| (plan.source_potentials[0], plan.source_potentials[1]) = (1e6, -1e6));
    assert!(matches!(opposite, ClusterError::DualInfeasible { source_index: 0, .. }), "{opposite}");
}

#[test]
fn the_certificate_refuses_false_claims_and_shapes() {
    let error = refusal(|plan| plan.cost += 0.01);
    assert!(matches!(error, ClusterError::DualityGap { .. }), "{error}");
    let nan_cost = refusal(|plan| plan.cost = f64::NAN);
    assert!(matches!(nan_cost, ClusterError::DualityGap { .. }), "{nan_cost}");
    let truncated = refusal(|plan| plan.sink_potentials.truncate(3));
    assert!(
        matches!(truncated, ClusterError::PlanShape { got: 3, expected: 4, .. }),
        "{truncated}"
    );
    let outside = refusal(|plan| plan.entries[0].source = 6);
    assert!(matches!(outside, ClusterError::EntryOutOfRange { source_index: 6, .. }), "{outside}");
    let (cost, plan) = solved();
    let narrow = certify(&cost, Weights::Uniform(4), SIDES.1, &plan).unwrap_err();
    assert!(matches!(narrow, ClusterError::CostShape { len: 24, .. }), "{narrow}");
}

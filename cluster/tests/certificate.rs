//! The certificate's power to refuse.

use cluster::{
    ClusterError, PointWeights, TransportPlan, TransportPlanEntry, certify_optimality,
    solve_transport,
};

use crate::common::{random_costs, uniform};

const SIDES: (PointWeights, PointWeights) = (PointWeights::Uniform(6), PointWeights::Uniform(4));

fn checked(
    cost: &[f64],
    plan: &TransportPlan,
) -> Result<cluster::OptimalityCertificate, ClusterError> {
    certify_optimality(cost, SIDES.0, SIDES.1, plan)
}

/// A solved problem to spoil: 6 sources, 4 sinks.
fn solved() -> (Vec<f64>, TransportPlan) {
    let cost = random_costs(5, 24);
    let plan = uniform(&cost, 6, 4).expect("a well-formed problem");
    checked(&cost, &plan).expect("the solver's own answer");
    (cost, plan)
}

/// Way to spoil a plan, and the beginning of the error in its `Debug` form.
type Case = (fn(&mut TransportPlan), &'static str);

const CASES: [Case; 14] = [
    // mass that moved, grew, vanished, or is no mass
    (|plan| plan.entries[0].sink = (plan.entries[0].sink + 1) % 4, "Marginal { side: \"sink\""),
    (|plan| plan.entries[0].mass += 0.01, "Marginal { side: \"source\""),
    (|plan| plan.entries.clear(), "Marginal { side: \"source\", index: 0, got: 0.0"),
    (|plan| plan.entries[0].mass = f64::NAN, "Weight {"),
    // a negative entry that its row and column make good
    (
        |plan| {
            plan.entries.extend([-0.01, 0.01].map(|mass| TransportPlanEntry {
                source: 0,
                sink: 0,
                mass,
            }))
        },
        "Weight {",
    ),
    // potentials
    (|plan| plan.source_potentials[2] += 0.01, "DualInfeasible { source_index: 2"),
    (|plan| plan.sink_potentials[1] -= 0.01, "DualityGap {"),
    (|plan| plan.sink_potentials[3] = f64::NAN, "DualInfeasible { source_index: 0, sink_index: 3"),
    // opposite shifts cancel in the dual value but not in the reduced costs of a plan with mixed
    // pairs
    (
        |plan| plan.source_potentials[..2].copy_from_slice(&[1e6, -1e6]),
        "DualInfeasible { source_index: 0",
    ),
    // false claims and shapes
    (|plan| plan.cost += 0.01, "DualityGap {"),
    (|plan| plan.cost = f64::NAN, "DualityGap {"),
    (|plan| plan.sink_potentials.truncate(3), "Length {"),
    (|plan| plan.entries[0].source = 6, "OutOfRange { name: \"source\", value: 6.0"),
    (|plan| plan.entries[0].sink = 4, "OutOfRange { name: \"sink\", value: 4.0"),
];

#[test]
fn the_certificate_refuses_spoilt_plans() {
    let (cost, plan) = solved();
    for (index, (spoil, expected)) in CASES.into_iter().enumerate() {
        let mut spoilt = plan.clone();
        spoil(&mut spoilt);
        let error = checked(&cost, &spoilt).expect_err("a spoilt plan must be refused");
        assert!(format!("{error:?}").starts_with(expected), "{index}: {error:?}");
    }
    let narrow = certify_optimality(&cost, PointWeights::Uniform(4), SIDES.1, &plan).unwrap_err();
    assert!(matches!(narrow, ClusterError::CostShape { len: 24, .. }), "{narrow}");
}

#[test]
fn the_certificate_refuses_a_feasible_plan_that_is_not_optimal() {
    // the dearer of the two matchings, with the potentials of the cheaper one
    let cost = [9.0, 2.0, 4.0, 1.0];
    let sides = (PointWeights::Uniform(2), PointWeights::Uniform(2));
    let mut plan = solve_transport(&cost, sides.0, sides.1).unwrap();
    plan.entries = vec![
        TransportPlanEntry { source: 0, sink: 0, mass: 0.5 },
        TransportPlanEntry { source: 1, sink: 1, mass: 0.5 },
    ];
    for claimed in [3.0, 5.0] {
        plan.cost = claimed;
        let error = certify_optimality(&cost, sides.0, sides.1, &plan).unwrap_err();
        assert!(matches!(error, ClusterError::DualityGap { primal: 5.0, .. }), "{error}");
    }
}

//! Slices of wrong length are refused by name at every public entry.

use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, Adam, Decisions, EvaluateActions, FeatureExtractor, GaeInputs, OnPolicyActor,
    ParamGroup, RlError, RolloutBuffer, StepOutcome, ValueFunction, evaluate_policy, gae,
};

use crate::common::PointReach;
use crate::common::steps::{
    ENVS, OnPolicyRun, Spoiling, StepArrays, policy, push, rolled_out, spec, step_arrays,
};

fn resize<T: Clone + Default>(values: &mut Vec<T>, change: isize) {
    let len = values.len().saturating_add_signed(change);
    values.resize(len, T::default());
}

/// The arrays of a step by name.
const ARRAYS: [&str; 13] = [
    "images",
    "vectors",
    "actions",
    "log_probs",
    "values",
    "next images",
    "next vectors",
    "final images",
    "final vectors",
    "rewards",
    "outcomes",
    "success",
    "success_at_end",
];

/// Lengthens or shortens one array of a step; returns the name that the error gives it.
fn spoil(arrays: &mut StepArrays, array: usize, change: isize) -> &'static str {
    let StepArrays { observations, decisions, transition, .. } = arrays;
    match ARRAYS[array] {
        "images" => resize(&mut observations.images, change),
        "vectors" => resize(&mut observations.vectors, change),
        "actions" => resize(&mut decisions.actions, change),
        "log_probs" => resize(&mut decisions.log_probs, change),
        "values" => resize(&mut decisions.values, change),
        "next images" => resize(&mut transition.observations.images, change),
        "next vectors" => resize(&mut transition.observations.vectors, change),
        "final images" => resize(&mut transition.final_observations.images, change),
        "final vectors" => resize(&mut transition.final_observations.vectors, change),
        "rewards" => resize(&mut transition.rewards, change),
        "outcomes" => resize(&mut transition.outcomes, change),
        "success" => resize(&mut transition.success, change),
        _ => resize(&mut transition.success_at_end, change),
    }
    ARRAYS[array].split(' ').next_back().unwrap_or("")
}

/// Returns `true` if a result is the error of the array of that name.
fn names(result: Result<(), RlError>, array: &str) -> bool {
    matches!(result, Err(RlError::ShapeMismatch { what, .. }) if what == array)
}

fn panics(run: impl FnOnce() + std::panic::UnwindSafe) -> String {
    let panic = std::panic::catch_unwind(run).unwrap_err();
    panic.downcast_ref::<String>().map_or_else(String::new, Clone::clone)
}

fn off_by() -> impl Strategy<Value = isize> {
    (-3isize..=3).prop_filter("a change", |change| *change != 0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_step_with_an_array_of_another_length_is_refused(
        array in 0..ARRAYS.len(),
        change in off_by(),
    ) {
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        let mut wrong = step_arrays();
        let name = spoil(&mut wrong, array, change);
        prop_assert!(names(push(&mut buffer, &wrong), name));
        // the buffer takes the right one afterwards
        prop_assert!(push(&mut buffer, &step_arrays()).is_ok());
    }

    #[test]
    fn values_of_another_length_are_refused(change in off_by()) {
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        let mut wrong = step_arrays();
        resize(&mut wrong.values, change);
        prop_assert!(names(push(&mut buffer, &wrong), "final_values"));
        push(&mut buffer, &step_arrays()).unwrap();
        let result = buffer.finish(&step_arrays().observations, &wrong.values);
        prop_assert!(names(result, "last_values"));
        buffer.finish(&step_arrays().observations, &[0.0; ENVS]).unwrap();
        let (right, wrong) = (&mut [0.0; ENVS], &mut wrong.values);
        prop_assert!(names(buffer.write_advantages_and_returns(0.9, 0.9, wrong, right), "advantages"));
        prop_assert!(names(buffer.write_advantages_and_returns(0.9, 0.9, right, wrong), "returns"));
    }

    #[test]
    fn a_policy_refuses_outputs_of_another_length(change in off_by()) {
        let (mut policy, seen) = (policy(), step_arrays().observations);
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let sized = |width: usize| {
            let mut out = vec![0.0; ENVS * width];
            resize(&mut out, change);
            out
        };
        let dim = policy.feature_dim();
        prop_assert!(names(policy.act(&seen, &mut (), &mut rng, &mut sized(2)), "actions"));
        prop_assert!(names(policy.mean_actions(&seen, &mut (), &mut sized(2)), "mean actions"));
        prop_assert!(names(policy.values(&seen, &mut sized(1)), "values"));
        prop_assert!(names(policy.features(&seen, &mut sized(dim)), "features"));
        let decisions = &mut Decisions::new(&spec());
        prop_assert!(names(policy.decide(&seen, &mut (), &sized(2), decisions), "noise"));
        for array in 2..5 {
            let mut wrong = step_arrays();
            let name = spoil(&mut wrong, array, change);
            let spoilt = &mut wrong.decisions;
            prop_assert!(names(policy.decide(&seen, &mut (), &[0.0; 2 * ENVS], spoilt), name));
            prop_assert!(names(policy.evaluate_actions(&seen, spoilt), name));
        }
    }

    #[test]
    fn a_policy_refuses_observations_of_another_length(
        array in 0..2usize,
        change in off_by(),
    ) {
        let (mut policy, mut wrong) = (policy(), step_arrays());
        spoil(&mut wrong, array, change);
        let seen = &wrong.observations;
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let shape = |result| matches!(result, Err(RlError::ShapeMismatch { .. }));
        let mut decisions = Decisions::new(&spec());
        prop_assert!(shape(policy.act(seen, &mut (), &mut rng, &mut [0.0; 2 * ENVS])));
        prop_assert!(shape(policy.mean_actions(seen, &mut (), &mut [0.0; 2 * ENVS])));
        prop_assert!(shape(policy.decide(seen, &mut (), &[0.0; 2 * ENVS], &mut decisions)));
        prop_assert!(shape(policy.evaluate_actions(seen, &mut decisions)));
        prop_assert!(shape(policy.values(seen, &mut [0.0; ENVS])));
        let mut features = vec![0.0; ENVS * policy.feature_dim()];
        prop_assert!(shape(policy.features(seen, &mut features)));
    }

    /// Whatever array an environment spoils, collection and evaluation say which one it was.
    #[test]
    fn an_environment_that_changes_a_length_is_refused(
        array in 5..ARRAYS.len(),
        change in off_by(),
    ) {
        let mut env = Spoiling::new(|out| {
            let mut all = step_arrays();
            std::mem::swap(&mut all.transition, out);
            spoil(&mut all, array, change);
            std::mem::swap(&mut all.transition, out);
        });
        let name = ARRAYS[array].split(' ').next_back().unwrap();
        prop_assert!(names(evaluate_policy(&mut env, &mut policy(), 1).map(|_| ()), name));
        prop_assert!(names(rolled_out(env), name));
    }
}

/// x and y exchanged in the actions: every length fits, and only the types tell.
#[test]
fn a_rollout_of_other_environments_is_refused() {
    let mut other = spec();
    other.action_irreps.swap(0, 1);
    let mut run = OnPolicyRun::new(PointReach::new(ENVS, 0), policy(), 2);
    run.buffer = RolloutBuffer::new(&other, 2).unwrap();
    let result = run.try_collect();
    assert!(matches!(result, Err(RlError::SpecMismatch { field: "action_irreps", .. })));
}

#[test]
fn gae_names_the_slice_that_does_not_fit() {
    let gae_with = |lens: [usize; 7]| {
        let [rewards, values, finals, last] = [0, 1, 3, 4].map(|i: usize| vec![0.0; lens[i]]);
        let outcomes = vec![StepOutcome::Running; lens[2]];
        let inputs = GaeInputs {
            rewards: &rewards,
            values: &values,
            outcomes: &outcomes,
            final_values: &finals,
            last_values: &last,
        };
        gae(&inputs, 0.9, 0.9, &mut vec![0.0; lens[5]], &mut vec![0.0; lens[6]]);
    };
    let names =
        ["rewards", "values", "outcomes", "final_values", "rewards", "advantages", "returns"];
    for (i, name) in names.into_iter().enumerate() {
        for change in [-1, 1] {
            let mut lens: [usize; 7] = [6, 6, 6, 6, 3, 6, 6];
            lens[i] = lens[i].saturating_add_signed(change);
            // six rewards are whole steps of two environments, too
            if (i, change) != (4, -1) {
                let message = panics(|| gae_with(lens));
                assert!(message.starts_with(&format!("{name}: got")), "{message}");
            }
        }
    }
}

#[test]
fn adam_names_the_slice_that_does_not_fit() {
    let step = |params: usize, gradient: usize, first: usize, second: usize, end: usize| {
        panics(move || {
            let mut adam = Adam::new(first, 1e-5);
            adam.second_moment.resize(second, 0.0);
            let group = ParamGroup { range: 0..end, learning_rate: 0.1 };
            adam.step(&[group], &mut vec![0.0; params], &vec![0.0; gradient]);
        })
    };
    for (message, start) in [
        (step(4, 3, 4, 4, 4), "gradient: got 3 values, expected 4"),
        (step(4, 4, 3, 4, 4), "first_moment: got 3 values, expected 4"),
        (step(4, 4, 4, 5, 4), "second_moment: got 5 values, expected 4"),
        (step(4, 4, 4, 4, 5), "the group 0..5 lies outside the 4 parameters"),
    ] {
        assert!(message.starts_with(start), "{message}");
    }
}

/// A second group that is wrong is found before the first one has changed anything.
#[test]
fn a_group_beyond_the_parameters_leaves_adam_alone() {
    #[expect(clippy::reversed_empty_ranges, reason = "such a group is wrong, too")]
    for wrong in [2..5, 3..2] {
        let mut adam = Adam::new(4, 1e-5);
        let (before, mut params) = (adam.clone(), [1.0; 4]);
        let groups = [0..4, wrong].map(|range| ParamGroup { range, learning_rate: 0.1 });
        let message = panics(std::panic::AssertUnwindSafe(|| {
            adam.step(&groups, &mut params, &[1.0; 4]);
        }));
        assert!(message.ends_with("lies outside the 4 parameters"), "{message}");
        assert_eq!((adam, params), (before, [1.0; 4]));
    }
}

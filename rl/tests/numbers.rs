//! Numbers that are infinite or not a number are refused by name before they change a parameter.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, AlgorithmState, MAX_ABS_OBSERVATION, Ppo, PpoSettings, RlError,
    RolloutBuffer, StepOutcome, Transition, evaluate_policy,
};

use crate::common::steps::{
    ENVS, Spoiling, StepArrays, policy, push, rolled_out, spec, step_arrays,
};

/// Function that invalidates a number.
type Change<T> = fn(&mut T);

/// Returns the quantity that a `NotFinite` error names.
fn not_finite(result: Result<(), RlError>) -> &'static str {
    match result {
        Err(RlError::NotFinite { what, .. }) => what,
        other => panic!("{other:?}"),
    }
}

/// The third step is the first of the second episode in environment 1, since the first one ended
/// after two.
#[test]
fn an_error_names_environment_component_and_step() {
    let spoils: [(Change<Transition>, &str); 4] = [
        (
            |t| t.observations.vectors[3] = f32::NAN,
            "a component of an observation vector is NaN (environment 1, component 1, step 1)",
        ),
        (
            |t| t.observations.vectors[4] = -1e30,
            "a component of an observation vector is -1e30 (environment 2, component 0, step 3)",
        ),
        (
            |t| {
                t.outcomes[2] = StepOutcome::Truncated;
                t.final_observations.vectors[5] = f32::INFINITY;
            },
            "a component of a final observation vector is inf (environment 2, component 1, step 3)",
        ),
        (|t| t.rewards[0] = f32::NEG_INFINITY, "a reward is -inf (environment 0, step 3)"),
    ];
    for (spoil, expected) in spoils {
        for collects in [false, true] {
            let mut steps = 0;
            let mut env = Spoiling::new(|t: &mut Transition| {
                steps += 1;
                match steps {
                    2 => {
                        t.outcomes[1] = StepOutcome::Truncated;
                        t.final_observations.vectors[2..4].fill(0.0);
                    }
                    3 => spoil(t),
                    _ => {}
                }
            });
            let result = if collects {
                rolled_out(env)
            } else {
                evaluate_policy(&mut env, &mut policy(), 1).map(|_| ())
            };
            let message = result.unwrap_err().to_string();
            assert!(message.starts_with(expected), "{message}");
        }
    }
    let mut wrong = step_arrays();
    wrong.decisions.actions[4] = f32::NAN;
    let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
    let message = push(&mut buffer, &wrong).unwrap_err().to_string();
    let expected = "an action is NaN (environment 2, component 0)";
    assert!(message.starts_with(expected), "{message}");
}

/// Squares of such numbers overflow the gradient, which names nothing that is of use.
#[test]
fn observations_far_from_order_one_are_refused() {
    for (value, refused) in [(MAX_ABS_OBSERVATION, false), (1e13, true), (-1e30, true)] {
        let mut wrong = step_arrays();
        wrong.transition.observations.vectors[5] = value;
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        let result = push(&mut buffer, &wrong);
        let too_large = matches!(result, Err(RlError::ObservationTooLarge { .. }));
        assert_eq!(too_large, refused, "{value:e}: {result:?}");
    }
}

#[test]
fn final_observations_of_running_episodes_have_no_meaning() {
    let env = Spoiling::new(|t| t.final_observations.vectors[5] = f32::NAN);
    assert!(rolled_out(env).is_ok());
}

#[test]
fn decisions_and_values_that_are_not_numbers_are_refused() {
    let spoils: [(Change<StepArrays>, &str); 5] = [
        (|p| p.decisions.actions[1] = f32::NAN, "an action"),
        (|p| p.decisions.log_probs[1] = f32::NEG_INFINITY, "a log-probability"),
        (|p| p.decisions.values[2] = f32::NAN, "a value"),
        (|p| p.values[0] = f32::NAN, "the value of a final observation"),
        (|p| p.observations.vectors[0] = f32::NAN, "a component of an observation vector"),
    ];
    for (spoil, name) in spoils {
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        let mut wrong = step_arrays();
        spoil(&mut wrong);
        assert_eq!(not_finite(push(&mut buffer, &wrong)), name);
    }
    let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
    push(&mut buffer, &step_arrays()).unwrap();
    let result = buffer.finish(&step_arrays().observations, &[0.0, f32::NAN, 0.0]);
    assert_eq!(not_finite(result), "a value");
}

fn one_step() -> RolloutBuffer {
    let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
    push(&mut buffer, &step_arrays()).unwrap();
    buffer.finish(&step_arrays().observations, &[0.0; ENVS]).unwrap();
    buffer
}

/// Returns the quantity for which an update fails.
fn refused_update(
    ppo: &mut Ppo,
    policy: &mut ActorCriticPolicy,
    buffer: &RolloutBuffer,
) -> &'static str {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    not_finite(ppo.update(policy, buffer, &mut rng).map(|_| ()))
}

/// Rewards that are finite but whose sum is not, and weights so large that the value is finite but
/// its gradient is not.
#[test]
fn returns_and_gradients_that_overflow_leave_the_parameters_alone() {
    let mut buffer = RolloutBuffer::new(&spec(), 2).unwrap();
    let mut huge = step_arrays();
    huge.transition.outcomes.fill(StepOutcome::Running);
    huge.transition.rewards.fill(3e38);
    push(&mut buffer, &huge).unwrap();
    push(&mut buffer, &huge).unwrap();
    buffer.finish(&huge.observations, &[0.0; ENVS]).unwrap();
    let mut steep = policy();
    // before the two log_std and the value's bias: the last layer of the critic
    let bias = steep.params().len() - 3;
    steep.params_mut()[bias - 2..bias].fill(1e30);
    for (mut policy, rollout, expected) in
        [(policy(), buffer, "a return"), (steep, one_step(), "the norm of the gradient")]
    {
        let settings = PpoSettings { max_kl: 1e9, ..PpoSettings::default() };
        let mut ppo = Ppo::new(settings, &policy).unwrap();
        let before = policy.params().to_vec();
        assert_eq!(refused_update(&mut ppo, &mut policy, &rollout), expected);
        assert_eq!((policy.params(), ppo.save().counters[0].1), (&before[..], 0));
    }
}

fn saved<'a>(first: &'a [f32], second: &'a [f32], counter: (&'a str, u64)) -> AlgorithmState<'a> {
    AlgorithmState {
        tensors: vec![("adam.first", first), ("adam.second", second)],
        counters: vec![counter],
    }
}

#[test]
fn saved_states_of_other_networks_and_damaged_ones_are_refused() {
    let policy = policy();
    let mut ppo = Ppo::new(PpoSettings::default(), &policy).unwrap();
    let zeros = vec![0.0; policy.params().len()];
    let steps = ("adam.steps", 7);
    for state in [
        saved(&zeros[1..], &zeros, steps),
        saved(&zeros, &zeros[1..], steps),
        saved(&zeros, &zeros, ("steps", 7)),
        AlgorithmState::default(),
    ] {
        let result = ppo.restore(&state);
        assert!(matches!(result, Err(RlError::StateMismatch { .. })), "{result:?}");
    }
    for (value, expected) in [(f32::NAN, "finite"), (-1.0, "no negative number")] {
        let mut wrong = zeros.clone();
        wrong[3] = value;
        let error = ppo.restore(&saved(&zeros, &wrong, steps)).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("`adam.second`") && message.contains(expected), "{message}");
        assert_eq!(ppo.save(), saved(&zeros, &zeros, ("adam.steps", 0)));
    }
    // above 2^53, f64 no longer tells one count from the next
    let most = 1 << 53;
    for count in [most + 1, u64::MAX] {
        let error = ppo.restore(&saved(&zeros, &zeros, ("adam.steps", count))).unwrap_err();
        assert!(error.to_string().contains("`adam.steps`"), "{error}");
    }
    for count in [7, most] {
        ppo.restore(&saved(&zeros, &zeros, ("adam.steps", count))).unwrap();
        assert_eq!(ppo.save(), saved(&zeros, &zeros, ("adam.steps", count)));
    }
}

/// Names can be chosen so that two layouts read alike when they are joined to one text.
#[test]
fn names_that_read_like_another_layout_are_refused() {
    let (three, two) = ([0.0; 3], [0.0; 2]);
    let counters = vec![("c", 0)];
    let own =
        AlgorithmState { tensors: vec![("a", &three), ("b", &two)], counters: counters.clone() };
    let joined = AlgorithmState { tensors: vec![("a [3], b", &two)], counters };
    let moved =
        AlgorithmState { tensors: vec![], counters: vec![("a [3]", 0), ("b [2]", 0), ("c", 0)] };
    assert!(own.check_same_layout(&own).is_ok());
    for other in [joined, moved] {
        match other.check_same_layout(&own) {
            Err(RlError::StateMismatch { got, expected }) => {
                assert_ne!(got, expected);
                assert_eq!(expected, r#""a" [3], "b" [2], "c""#);
            }
            result => panic!("{result:?}"),
        }
    }
}

/// Adam's first step is as large as its rate, and f32 ends at 3.4e38.
#[test]
fn parameters_that_the_last_step_makes_infinite_are_reported() {
    let mut policy = policy();
    let settings = PpoSettings {
        epochs: 1,
        max_kl: 1e9,
        head_learning_rate: 3.4e38,
        ..PpoSettings::default()
    };
    let mut ppo = Ppo::new(settings, &policy).unwrap();
    let buffer = one_step();
    let what = refused_update(&mut ppo, &mut policy, &buffer);
    assert_eq!(what, "a parameter after the update");
}

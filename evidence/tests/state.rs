//! What is remembered, and the file that holds it.

use evidence::{Account, Recogniser, Situation};
use worlds::WorldKind;

use crate::common::{knowing, rng, rollout};

#[test]
fn memory_is_bounded_and_survives_a_file() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 2);
    let size =
        |any: &Recogniser| any.state(serde_json::value::Serializer).unwrap().to_string().len();
    let before = size(&recogniser);
    let seen = rollout(WorldKind::Appearance, 1000, 0, 0);
    for _ in 0..1000 {
        recogniser.learn(0, &seen, &mut rng()).unwrap();
    }
    assert!(size(&recogniser) < 11 * before / 10, "a thousand visits later");
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let mut restored = Recogniser::new(*recogniser.settings()).unwrap();
    restored.restore(&state).unwrap();
    assert_eq!(restored, recogniser);
    assert!(restored.restore(&serde_json::json!("text")).is_err());
    // the index after the last one is that of the next new policy, which no decision proposes
    let unknown = Situation { collector: 2, ..Situation::default() };
    for (error, policy) in [
        (restored.learn(7, &seen, &mut rng()).unwrap_err(), 7),
        (restored.assign(&seen, Situation::of(7), &mut rng()).unwrap_err(), 7),
        (restored.review(&seen, unknown, &mut rng()).unwrap_err(), 2),
    ] {
        assert_eq!(error.to_string(), format!("policy {policy} was named, 2 are known"));
    }
}

#[test]
fn damaged_states_are_refused() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 2);
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let damaged = |damage: fn(&mut serde_json::Value)| {
        let mut damaged = state.clone();
        damage(&mut damaged);
        let mut restored = recogniser.clone();
        let error = restored.restore(&damaged).unwrap_err();
        assert_eq!(restored, recogniser, "nothing is taken back by halves");
        error.to_string()
    };
    let huge = damaged(|s| s["policies"][1]["accounts"][0]["picture"][0] = 1e300.into());
    assert!(huge.contains("picture holds inf"), "{huge}");
    let short = damaged(|s| s["policies"][0]["accounts"][3]["vector"] = serde_json::json!([0.5]));
    assert!(short.contains("vector holds 1 values, expected 2"), "{short}");
    let empty = damaged(|s| s["policies"][1]["accounts"] = serde_json::json!([]));
    assert!(empty.contains("got 0 episodes"), "{empty}");
    let long = damaged(|s| {
        let first = s["policies"][0]["accounts"][0].clone();
        s["policies"][0]["accounts"].as_array_mut().unwrap().push(first);
    });
    assert!(long.contains("41 accounts of one policy, expected at most 40"), "{long}");
    let heir = damaged(|s| s["policies"][1]["heir"] = 2.into());
    assert!(heir.contains("policy 2 was named, 2 are known"), "{heir}");
    let apart = damaged(|s| s["policies"][1]["apart"] = serde_json::json!([0, 3]));
    assert!(apart.contains("policy 3 was named, 2 are known"), "{apart}");
}

/// Whoever follows heirs must come to one that acts.
#[test]
fn states_whose_heirs_lead_nowhere_are_refused() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 3);
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let with_heirs = |heirs: [Option<usize>; 3]| {
        let mut state = state.clone();
        for (policy, heir) in state["policies"].as_array_mut().unwrap().iter_mut().zip(heirs) {
            policy["heir"] = serde_json::json!(heir);
        }
        let mut restored = recogniser.clone();
        let result = restored.restore(&state);
        assert!(result.is_ok() || restored == recogniser);
        result.map_err(|error| error.to_string())
    };
    assert_eq!(with_heirs([Some(2), None, Some(1)]), Ok(()));
    assert_eq!(with_heirs([Some(1), None, Some(1)]), Ok(()));
    for circle in [
        [None, Some(1), None],
        [None, Some(2), Some(1)],
        [Some(2), Some(0), Some(1)],
        [Some(1), Some(1), None],
    ] {
        let message = with_heirs(circle).unwrap_err();
        assert!(message.contains("follow each other in a circle"), "{message}");
    }
}

#[test]
fn states_with_unknown_fields_are_refused() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    for at in ["", "/policies/0", "/policies/0/accounts/7"] {
        let mut other = state.clone();
        let place = other.pointer_mut(at).unwrap().as_object_mut().unwrap();
        place.insert("heirs".to_owned(), 1.into());
        let mut restored = recogniser.clone();
        let message = restored.restore(&other).unwrap_err().to_string();
        assert!(message.contains("unknown field `heirs`"), "{at}: {message}");
        assert_eq!(restored, recogniser);
    }
}

#[test]
fn held_rollouts_that_no_run_could_have_are_refused() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let unknown = rollout(WorldKind::Appearance, 1000, 3, 0);
    recogniser.assign(&unknown, Situation::of(0), &mut rng()).unwrap();
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    assert!(recogniser.clone().restore(&state).is_ok());
    let accounts = &state["held"][0]["accounts"];
    let many = vec![accounts.as_array().unwrap().clone(); 3].concat();
    let cases = [
        ("collector", 2.into(), "policy 2 was named"),
        ("accounts", Vec::<serde_json::Value>::new().into(), "got 0 episodes"),
        ("accounts", many.into(), "60"),
    ];
    for (field, value, part) in cases {
        let mut wrong = state.clone();
        wrong["held"][0][field] = value;
        let message = recogniser.clone().restore(&wrong).unwrap_err().to_string();
        assert!(message.contains(part), "{field}: {message}");
    }
}

#[test]
fn states_of_another_version_are_refused_by_name() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let mut next = state.clone();
    next["format"] = 4.into();
    next["policies"][0]["more"] = 1.into();
    let message = recogniser.restore(&next).unwrap_err().to_string();
    let expected = "the state has format 4, expected 3: go on with";
    assert!(message.starts_with(expected), "{message}");
    assert!(recogniser.restore(&state["policies"]).is_err());
    assert!(recogniser.restore(&state).is_ok());
}

/// Nothing is learnt and nothing taken back that no comparison could use.
#[test]
fn damaged_accounts_are_refused() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 2);
    let seen = rollout(WorldKind::Appearance, 1000, 0, 0);
    let damaged = |damage: fn(&mut Account)| {
        let mut accounts = seen.clone();
        damage(&mut accounts[7]);
        let mut learning = recogniser.clone();
        let error = learning.learn(1, &accounts, &mut rng()).unwrap_err();
        assert_eq!(learning, recogniser, "nothing is learnt by halves");
        error.to_string()
    };
    assert!(damaged(|a| a.picture[3] = f32::NAN).contains("picture holds NaN"));
    assert!(damaged(|a| a.earned = Some(f32::INFINITY)).contains("earnings holds inf"));
    assert!(damaged(|a| a.vector = Vec::new()).contains("vector holds 0 values, expected 2"));
    assert!(damaged(|a| a.motion = Some(vec![0.0])).contains("motion holds 1 values, expected 4"));
    let none = recogniser.clone().learn(0, &[], &mut rng()).unwrap_err();
    assert_eq!(none.to_string(), "got 0 episodes, expected at least 1");
}

/// Accounts that pass the first checks and cannot be compared all the same.
#[test]
fn an_error_leaves_everything_as_it_was() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let mut seen = rollout(WorldKind::Appearance, 1000, 0, 0);
    seen[3].slope = None;
    for policy in [0, 1] {
        let mut learning = recogniser.clone();
        assert!(learning.learn(policy, &seen, &mut rng()).is_err());
        assert_eq!(learning, recogniser);
    }
    let mut learning = recogniser.clone();
    assert!(learning.compare(0, 0, &seen, &mut rng()).is_err());
    assert!(learning.merge(0, 1, &seen[..5], &seen, &mut rng()).is_err());
    assert_eq!(learning, recogniser);
    for extreme in [f32::MAX, f32::MIN_POSITIVE] {
        let mut extremes = rollout(WorldKind::Appearance, 1000, 0, 0);
        let pictures = extremes.iter_mut().flat_map(|account| &mut account.picture);
        pictures.enumerate().for_each(|(i, v)| *v = if i % 3 == 0 { extreme } else { -extreme });
        let mut trial = recogniser.clone();
        let learnt = trial.learn(1, &extremes, &mut rng());
        assert!(learnt.is_ok() || trial == recogniser, "{learnt:?}");
    }
}

//! What is remembered, and the file that holds it.

use evidence::{EpisodeSummary, Recogniser, RolloutDecisionContext};
use serde_json::{Value, json};
use worlds::WorldKind;

use crate::common::{knowing, rng, rollout};

const KIND: WorldKind = WorldKind::Appearance;

fn state(recogniser: &Recogniser) -> Value {
    recogniser.serialise_state(serde_json::value::Serializer).unwrap()
}

#[test]
fn memory_is_bounded_and_survives_a_file() {
    let mut recogniser = knowing(KIND, 1000, 2);
    let size = |any: &Recogniser| state(any).to_string().len();
    let before = size(&recogniser);
    let seen = rollout(KIND, 1000, 0, 0);
    for _ in 0..1000 {
        recogniser.record_training(0, &seen, &mut rng()).unwrap();
    }
    assert!(size(&recogniser) < 11 * before / 10, "a thousand visits later");
    let mut restored = Recogniser::new(*recogniser.settings()).unwrap();
    restored.restore_state(&state(&recogniser)).unwrap();
    assert_eq!(restored, recogniser);
    // the index after the last one is that of the next new policy, which no decision proposes
    let unknown = RolloutDecisionContext { collector: 2, ..RolloutDecisionContext::default() };
    for (error, policy) in [
        (restored.record_training(7, &seen, &mut rng()).unwrap_err(), 7),
        (
            restored
                .assign_rollout(&seen, RolloutDecisionContext::for_collector(7), &mut rng())
                .unwrap_err(),
            7,
        ),
        (restored.review_proposed_policy(&seen, unknown, &mut rng()).unwrap_err(), 2),
    ] {
        assert_eq!(error.to_string(), format!("policy {policy} was named, 2 are known"));
    }
}

/// Each case sets one field below a place of the state.
#[test]
fn damaged_states_are_refused() {
    let mut recogniser = knowing(KIND, 1000, 2);
    recogniser
        .assign_rollout(
            &rollout(KIND, 1000, 3, 0),
            RolloutDecisionContext::for_collector(0),
            &mut rng(),
        )
        .unwrap();
    let whole = state(&recogniser);
    assert!(recogniser.clone().restore_state(&whole).is_ok());
    let summary = whole["policies"][0]["accounts"][0].clone();
    let many = json!(vec![summary; 41]);
    let cases = [
        ("/policies/1/accounts/0", "picture", json!([1e300]), "image holds 1 values, expected 64"),
        ("/policies/1/accounts/0", "vector", json!([1e300, 0.0]), "vector holds inf"),
        ("/policies/0/accounts/3", "vector", json!([0.5]), "vector holds 1 values, expected 2"),
        ("/policies/1", "accounts", json!([]), "got 0 episodes"),
        ("/policies/0", "accounts", many.clone(), "41 episodes of one policy, expected at most 40"),
        ("/policies/0", "after_update", many.clone(), "41 episodes of one policy"),
        ("/policies/1", "heir", 2.into(), "policy 2 was named, 2 are known"),
        ("/policies/1", "heir", 1.into(), "form a cycle"),
        ("/policies/1", "apart", json!([0, 3]), "policy 3 was named, 2 are known"),
        ("/held/0", "collector", 3.into(), "policy 3 was named, 2 are known"),
        ("/held/0", "accounts", json!([]), "got 0 episodes"),
        ("/held/0", "accounts", many, "41 episodes"),
        ("", "last_trained", 2.into(), "policy 2 was named, 2 are known"),
        ("", "heirs", 1.into(), "unknown field `heirs`"),
        ("/policies/0", "heirs", 1.into(), "unknown field `heirs`"),
        ("/policies/0/accounts/7", "heirs", 1.into(), "unknown field `heirs`"),
        ("", "format", 4.into(), "the state has format 4, expected 3: continue with"),
    ];
    for (place, field, value, part) in cases {
        let mut damaged = whole.clone();
        damaged.pointer_mut(place).unwrap()[field] = value;
        let mut restored = recogniser.clone();
        let message = restored.restore_state(&damaged).unwrap_err().to_string();
        assert!(message.contains(part), "{place} {field}: {message}");
        assert_eq!(restored, recogniser, "nothing is restored by halves");
    }
    assert!(recogniser.restore_state(&json!("text")).is_err());
}

/// Whoever follows merges must come to a policy that acts.
#[test]
fn states_with_cycles_of_merges_are_refused() {
    let recogniser = knowing(KIND, 1000, 3);
    let with_merges = |heirs: [Option<usize>; 3]| {
        let mut state = state(&recogniser);
        for (policy, heir) in state["policies"].as_array_mut().unwrap().iter_mut().zip(heirs) {
            policy["heir"] = json!(heir);
        }
        recogniser.clone().restore_state(&state).is_ok()
    };
    assert!(with_merges([Some(2), None, Some(1)]) && with_merges([Some(1), None, Some(1)]));
    assert!(!with_merges([None, Some(2), Some(1)]) && !with_merges([Some(2), Some(0), Some(1)]));
}

/// Nothing is remembered that no comparison could use.
#[test]
fn an_error_leaves_everything_as_it_was() {
    let recogniser = knowing(KIND, 1000, 2);
    let seen = rollout(KIND, 1000, 0, 0);
    let damaged = |damage: fn(&mut EpisodeSummary)| {
        let mut summaries = seen.clone();
        damage(&mut summaries[7]);
        for policy in [0, 1, 2] {
            let mut other = recogniser.clone();
            assert!(other.record_training(policy, &summaries, &mut rng()).is_err());
            assert!(other.confirm_duplicate(0, 1, &summaries, &mut rng()).is_err());
            assert!(other.recheck_and_merge(0, 1, &seen[..5], &summaries, &mut rng()).is_err());
            assert_eq!(other, recogniser);
        }
        recogniser.clone().record_training(1, &summaries, &mut rng()).unwrap_err().to_string()
    };
    assert!(damaged(|a| a.image_features[3] = f32::NAN).contains("image holds NaN"));
    assert!(damaged(|a| a.episode_return = Some(f32::INFINITY)).contains("return holds inf"));
    assert!(damaged(|a| a.first_vector = Vec::new()).contains("vector holds 0 values, expected 2"));
    assert!(damaged(|a| a.motion = Some(vec![0.0])).contains("motion holds 1 values, expected 4"));
    // passes the first checks, and cannot be compared all the same
    damaged(|a| a.reward_gradient = None);
    let none = recogniser.clone().record_training(0, &[], &mut rng()).unwrap_err();
    assert_eq!(none.to_string(), "got 0 episodes, expected at least 1");
    for extreme in [f32::MAX, f32::MIN_POSITIVE] {
        let mut extremes = seen.clone();
        let features = extremes.iter_mut().flat_map(|summary| &mut summary.image_features);
        features.enumerate().for_each(|(i, v)| *v = if i % 3 == 0 { extreme } else { -extreme });
        let mut other = recogniser.clone();
        let result = other.record_training(1, &extremes, &mut rng());
        assert!(result.is_ok() || other == recogniser, "{result:?}");
    }
}

//! Settings by path, as `--set` takes them.

use covers::presets::{Budget, Method};
use covers::{
    Experiment, LearnerError, LearnerSettings, SettingOverride, apply_overrides as apply,
};
use learner::overrides::{from_json_value, setting_differences};

fn smoke() -> Experiment {
    Budget::Smoke.preset_experiment(Method::Covers)
}

fn set(texts: &[&str]) -> Result<Experiment, LearnerError> {
    let overrides: Result<Vec<SettingOverride>, _> =
        texts.iter().map(|text| text.parse()).collect();
    apply(&overrides?, smoke())
}

#[test]
fn any_field_can_be_set() {
    let changed = set(&[
        "covers.ppo.gamma=0.97",
        "learner.covers.seed=7",
        "evaluation.every=5",
        "evaluation.visit_rounds=1",
        "schedule.groups.0.decisions=9",
        "covers.grouping=oracle",
    ])
    .unwrap();
    let LearnerSettings::Covers(covers) = &changed.learner else {
        panic!("{:?}", changed.learner);
    };
    assert_eq!((covers.ppo.gamma, covers.seed), (0.97, 7));
    assert_eq!(changed.evaluation.every, Some(5));
    assert_eq!(changed.schedule.groups[0].decisions, 9);
    let list = setting_differences(&smoke(), &changed).unwrap();
    assert!(list.contains("`learner.covers.ppo.gamma` 0.95 and 0.97"), "{list}");
    assert_eq!(list.split("; ").count(), 6, "{list}");
}

#[test]
fn unknown_fields_name_the_nearest_known_one() {
    for (text, nearest) in [
        ("covers.ppo.gama=0.9", "covers.ppo.gamma"),
        ("gamma=0.9", "covers.ppo.gamma"),
        ("seed=5", "covers.seed"),
        ("evaluation.round=2", "evaluation.rounds"),
        ("schedule.groups.9.decisions=9", "schedule.groups.0.decisions"),
    ] {
        let message = set(&[text]).unwrap_err().to_string();
        let asked = format!("did you mean `{nearest}`?");
        assert!(message.contains(&asked), "{message}");
    }
    let text = serde_json::to_string(&smoke()).unwrap();
    let wrong = serde_json::from_str(&text.replace("\"gamma\"", "\"gama\"")).unwrap();
    let message = from_json_value::<Experiment>(wrong).unwrap_err().to_string();
    assert!(message.contains("learner.covers.ppo.gama"), "{message}");
    assert!(message.contains("did you mean `gamma`?"), "{message}");
    let other = set(&["off_policy.sac.gamma=0.9"]).unwrap_err().to_string();
    assert!(other.contains("methods that learn by SAC have `off_policy`"), "{other}");
    let far = set(&["covers.zzzzzzzz=1"]).unwrap_err().to_string();
    assert!(!far.contains("methods that"), "{far}");
    let own = set(&["covers.ppo.gama=0.9"]).unwrap_err().to_string();
    assert!(own.ends_with("`covers.ppo.gama`: did you mean `covers.ppo.gamma`?"), "{own}");
}

#[test]
fn the_last_value_of_a_setting_counts() {
    let changed = set(&["covers.seed=much", "covers.seed=3"]).unwrap();
    assert_eq!(changed.learner.seed(), 3);
}

#[test]
fn values_of_other_types_are_refused_with_their_path() {
    let message = set(&["covers.ppo.gamma=much"]).unwrap_err().to_string();
    assert!(message.contains("setting `covers.ppo.gamma`"), "{message}");
    let missing_value = set(&["covers.ppo.gamma"]).unwrap_err().to_string();
    assert!(missing_value.contains("PATH=VALUE"), "{missing_value}");
}

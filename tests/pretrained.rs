//! The policies that come with the project still load, recognise their groups, and act.

use std::path::Path;

use covers::evaluation::{EvaluationResults, Evaluator, OwnPolicyByGroup};
use covers::{RunFolder, SwitchableVecEnv, TaskLabel};
use envs::{ExtraViews, TaskGroup, TaskRegistry, TaskVariant};
use symmetry::D2;

/// Checks the policies in this folder of `assets`, whose pictures show `beside`, which solve at
/// least the share `success` of each group.
fn know_their_groups_and_solve_them(name: &str, beside: ExtraViews, success: f64) {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    let folder = assets.join(name);
    let folder = RunFolder::from_path(&folder);
    let mut experiment = folder.read_experiment().unwrap().with_threads(2);
    assert_eq!(experiment.envs.camera.extra_views, beside);
    for plan in &mut experiment.schedule.groups {
        plan.variants = vec![D2::Identity];
    }
    let spec = SwitchableVecEnv::env_spec(&experiment.envs);
    let labels = TaskLabel::default();
    let settings = &experiment.learner;
    let loaded = folder.load_learner_with_own_policies(settings, &spec, &labels);
    let (mut learner, own) = loaded.unwrap();
    assert_eq!(own, OwnPolicyByGroup::default(), "a pack has no books");
    assert_eq!(learner.policy_count(), 4);
    let (envs, tasks) = (experiment.envs.for_evaluation(), TaskRegistry::with_standard());
    let mut evaluator = Evaluator::new(envs, &tasks, experiment.schedule, 5, labels).unwrap();
    let mut findings = EvaluationResults::default();
    for (group, element) in TaskGroup::STANDARD.into_iter().zip(D2::ALL) {
        let variant = TaskVariant { group, element };
        evaluator.score_variant(&mut *learner, variant, &own, 1, &mut findings).unwrap();
    }
    let mut chosen = Vec::new();
    for score in findings.scores {
        assert!(score.success >= success, "{score:?}");
        assert_eq!(score.seen_in_training, score.element == D2::Identity);
        chosen.push(score.policy);
    }
    chosen.sort_unstable();
    assert_eq!(chosen, [0, 1, 2, 3], "every group has a policy of its own");
}

#[test]
fn policies_with_close_ups_know_their_groups_and_solve_them() {
    know_their_groups_and_solve_them("pretrained", ExtraViews::CloseUp, 0.9);
}

#[test]
fn policies_for_robots_know_their_groups_and_solve_them() {
    know_their_groups_and_solve_them("pretrained-robot", ExtraViews::First, 0.7);
}

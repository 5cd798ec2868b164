//! The policies that come with the project still load, recognise their groups, and act.

use std::path::Path;

use covers::evaluation::{Evaluator, Findings};
use covers::{Labels, RunFolder, Stream};
use envs::{TaskGroup, TaskRegistry, TaskVariant};
use symmetry::D2;

#[test]
fn pretrained_policies_know_their_groups_and_solve_them() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/pretrained");
    let folder = RunFolder::open(&folder);
    let mut experiment = folder.experiment().unwrap().with_threads(2);
    for plan in &mut experiment.schedule.groups {
        plan.variants = vec![D2::Identity];
    }
    let spec = Stream::spec_of(&experiment.envs);
    let labels = Labels::default();
    let learner = &experiment.learner;
    let mut learner = folder.load_learner(learner, &spec, &labels).unwrap();
    assert_eq!(learner.policies(), 4);
    let (envs, tasks) = (experiment.envs, TaskRegistry::standard());
    let mut evaluator = Evaluator::new(envs, &tasks, experiment.schedule, 5, labels).unwrap();
    let mut findings = Findings::default();
    for (group, element) in TaskGroup::STANDARD.into_iter().zip(D2::ALL) {
        let variant = TaskVariant { group, element };
        evaluator
            .variant(&mut *learner, variant, 1, &mut findings)
            .unwrap();
    }
    let mut chosen = Vec::new();
    for score in findings.scores {
        assert!(score.success >= 0.9, "{score:?}");
        assert_eq!(score.seen, score.element == D2::Identity);
        chosen.push(score.policy);
    }
    chosen.sort_unstable();
    assert_eq!(chosen, [0, 1, 2, 3], "every group has a policy of its own");
}

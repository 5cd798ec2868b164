//! The policies that come with the project still load, recognise their groups, and act.

#![allow(clippy::unwrap_used)]

use std::path::Path;

use covers::evaluation::Evaluator;
use covers::{Covers, RunFolder, Stream};
use envs::{TaskGroup, TaskVariant};
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
    let (mut covers, _) = Covers::load(&folder.checkpoint(), &spec).unwrap();
    assert_eq!(covers.policies(), 4);
    let mut evaluator = Evaluator::new(experiment.envs, experiment.schedule, 5).unwrap();
    let mut chosen = Vec::new();
    for (group, element) in TaskGroup::STANDARD.into_iter().zip(D2::ALL) {
        let variant = TaskVariant { group, element };
        let score = evaluator.variant(&mut covers, variant, 1).unwrap();
        assert!(score.success >= 0.9, "{score:?}");
        assert_eq!(score.seen, element == D2::Identity);
        chosen.push(score.policy);
    }
    chosen.sort_unstable();
    assert_eq!(chosen, [0, 1, 2, 3], "every group has a policy of its own");
}

//! The suite learns: a real group from pixels, which an untrained policy does not solve.

use covers::presets::{Budget, Method};
use covers::schedule::Schedule;
use covers::{Experiment, Run, RunFolder};
use envs::TaskGroup;

/// Decisions in Goal Reach.
const DECISIONS: usize = 8000;

fn experiment() -> Experiment {
    Experiment {
        schedule: Schedule::shuffled(1, &[(TaskGroup::GOAL_REACH, DECISIONS)]),
        ..Budget::Short.experiment(Method::Covers)
    }
}

#[test]
fn goal_reach_is_learnt_from_pixels() {
    let name = format!("covers-learns-{}", std::process::id());
    let folder = RunFolder::create(&std::env::temp_dir(), &name).unwrap();
    let path = folder.path().to_owned();
    let mut run = Run::start(experiment(), folder).unwrap();
    let untrained = run.evaluate(1).unwrap();
    while run.advance().unwrap().is_some() {}
    let trained = run.summary().unwrap().unwrap().variants;
    std::fs::remove_dir_all(path).unwrap();
    assert_eq!((untrained.len(), trained.len()), (4, 4));
    for (before, after) in untrained.iter().zip(&trained) {
        assert!(before.success <= 0.5, "{before:?}");
        assert!(after.success >= 0.9, "{after:?}");
    }
}

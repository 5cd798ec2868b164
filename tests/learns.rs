//! The suite learns: a real group from pixels, which an untrained policy does not solve.

use covers::presets::{Budget, Method};
use covers::schedule::TaskSchedule;
use covers::{Experiment, Run, RunFolder};
use envs::TaskGroup;

use crate::common::scratch::Scratch;

/// Decisions in Goal Reach.
const DECISIONS: usize = 8000;

fn experiment() -> Experiment {
    Experiment {
        schedule: TaskSchedule::shuffled(1, &[(TaskGroup::GOAL_REACH, DECISIONS)]),
        ..Budget::Short.preset_experiment(Method::Covers)
    }
}

#[test]
fn goal_reach_is_learnt_from_pixels() {
    let scratch = Scratch::new("learns");
    let folder = RunFolder::create(&scratch.0, "run").unwrap();
    let mut run = Run::start(experiment(), folder).unwrap();
    let untrained = run.evaluate(1).unwrap();
    while run.advance().unwrap().is_some() {}
    let trained = run.summary().unwrap().unwrap().variants;
    assert_eq!((untrained.len(), trained.len()), (4, 4));
    for (before, after) in untrained.iter().zip(&trained) {
        assert!(before.success <= 0.5, "{before:?}");
        assert!(after.success >= 0.9, "{after:?}");
    }
}

//! Tests of the recordings and the errors of `covers-rerun`.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use clap::Parser;
use covers::presets::{Budget, Method};
use covers::{CoversError, Experiment, Run, RunError, RunFolder};
use covers_rerun::RerunOptions;
use envs::Embodiment;

#[path = "../../tests/common/scratch.rs"]
mod scratch;

use scratch::Scratch;

/// Folder of the policies that come with the project.
const POLICIES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/pretrained");

fn rerun(run: &str, out: &Path, more: &[&str]) -> Result<String, CoversError> {
    let arguments = [&["covers-rerun", run, "--out", out.to_str().unwrap()], more].concat();
    let mut printed = Vec::new();
    RerunOptions::try_parse_from(arguments).unwrap().run(&mut printed)?;
    Ok(String::from_utf8(printed).unwrap())
}

/// Returns an experiment with short episodes of two groups, four environments and no arm.
fn small() -> Experiment {
    let mut experiment = Budget::Smoke.preset_experiment(Method::Covers);
    experiment = experiment.with_embodiment(Embodiment::FLOATING_HAND).with_threads(1);
    experiment.schedule.groups.truncate(2);
    experiment.envs.num_envs = 4;
    experiment.envs.control.horizon = 50;
    experiment
}

/// Returns `true` if a recording has an entity of this name. The file holds names as plain text.
fn holds(recording: &[u8], entity: &str) -> bool {
    let mut places = recording.windows(entity.len());
    places.any(|place| place == entity.as_bytes())
}

#[test]
fn a_recording_names_what_it_holds() {
    let scratch = Scratch::new("rerun");
    let folder = RunFolder::create(&scratch.0, "run").unwrap();
    let mut run = Run::start(small(), folder).unwrap();
    while run.advance().unwrap().is_some() {}
    let written = run.folder().path().to_str().unwrap().to_owned();
    drop(run);
    let film = scratch.0.join("new/film.rrd");
    let said = rerun(&written, &film, &["--group", "button-press"]).unwrap();
    assert!(said.contains("button-press half turn: policy 0"), "{said}");
    let bytes = fs::read(&film).unwrap();
    assert!(bytes.starts_with(b"RRF"));
    let half_turn = "/button-press/half-turn";
    for entity in ["/stream/group", "/stream/policy", "/stream/reward", half_turn] {
        assert!(holds(&bytes, entity), "{entity}");
    }
    assert!(!holds(&bytes, "/goal-reach/half-turn"));
    let again = rerun(&written, &film, &[]).unwrap_err();
    assert!(matches!(again, CoversError::Run(RunError::FileExists { .. })), "{again}");
}

#[test]
fn other_endings_and_groups_are_refused_before_anything_is_written() {
    let scratch = Scratch::new("rerun-refused");
    let gif = scratch.0.join("film.gif");
    let error = rerun(POLICIES, &gif, &[]).unwrap_err().to_string();
    assert!(error.contains("the ending .rrd"), "{error}");
    let film = scratch.0.join("film.rrd");
    let group_error = rerun(POLICIES, &film, &["--group", "no-group"]).unwrap_err();
    assert!(group_error.to_string().contains("no-group"), "{group_error}");
    let run_error = rerun("no-run", &film, &[]).unwrap_err();
    assert!(run_error.to_string().contains("no-run"), "{run_error}");
    assert_eq!(fs::read_dir(&scratch.0).unwrap().count(), 0);
    assert!(!RunFolder::from_path(Path::new("no-run")).holds_run());
}

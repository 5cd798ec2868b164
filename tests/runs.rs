//! Whole runs: the same bytes for the same seed and any number of threads, and clear refusals.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;
use covers::cli::StreamOptions;
use covers::experiment::{Experiment, Summary, run};
use covers::{Covers, CoversSettings, RunFolder, Stream};
use envs::{Camera, Embodiment, TaskGroup, VecEnvSettings};
use rl::VectorEnv;

/// A folder of this test's own, gone when it ends.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn smoke(parent: &Path, seed: u64, threads: usize) -> (Summary, Vec<Vec<u8>>) {
    let experiment = Experiment::smoke().with_seed(seed).with_threads(threads);
    let folder = RunFolder::create(parent, "run").unwrap();
    let mut rollouts = 0;
    let summary = run(&experiment, &folder, &mut |_| rollouts += 1).unwrap();
    assert_eq!(rollouts, experiment.total_rollouts());
    let files = ["metrics.csv", "evaluation.csv", "contact_sheet.png"];
    let bytes = files.map(|file| fs::read(folder.path().join(file)).unwrap());
    (summary, bytes.to_vec())
}

#[test]
fn equal_seeds_give_equal_bytes_on_any_number_of_threads() {
    let scratch = Scratch::new("bytes");
    let (summary, reference) = smoke(&scratch.0, 3, 1);
    assert_eq!(summary.groups.len(), 4);
    assert!(summary.policies >= 1 && summary.decisions >= 8 * 80);
    let rows = String::from_utf8(reference[0].clone()).unwrap();
    assert_eq!(
        rows.lines().count(),
        1 + Experiment::smoke().total_rollouts()
    );
    assert!(
        smoke(&scratch.0, 3, 1).1 == reference,
        "a second run differs"
    );
    assert!(smoke(&scratch.0, 3, 2).1 == reference, "two threads differ");
    assert!(
        smoke(&scratch.0, 4, 1).1[0] != reference[0],
        "the seed does nothing"
    );
}

#[test]
fn no_run_overwrites_another() {
    let scratch = Scratch::new("folders");
    let paths: Vec<_> = (0..3)
        .map(|_| RunFolder::create(&scratch.0, "short-seed0").unwrap())
        .map(|folder| folder.path().file_name().unwrap().to_owned())
        .collect();
    assert_eq!(paths, ["short-seed0", "short-seed0-2", "short-seed0-3"]);
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let scratch = Scratch::new("blocked");
    let file = scratch.0.join("file");
    fs::write(&file, "not a folder").unwrap();
    let message = RunFolder::create(&file, "run").unwrap_err().to_string();
    assert!(message.contains(&file.display().to_string()), "{message}");
}

#[test]
fn options_are_checked_and_named() {
    let refuse = |arguments: &[&str]| {
        let all = [&["continual_stream"], arguments].concat();
        StreamOptions::try_parse_from(all).unwrap_err().to_string()
    };
    assert!(refuse(&["--budgit", "short"]).contains("--budgit"));
    assert!(refuse(&["--budget", "long"]).contains("[possible values: smoke, short, full]"));
    assert!(refuse(&["--threads", "0"]).contains("0 is not in 1..=1024"));
    assert!(refuse(&["--seed", "minus one"]).contains("minus one"));
    assert!(
        refuse(&["--embodiment", "ur5"])
            .contains("unknown embodiment `ur5`: expected sawyer or hand")
    );
}

#[test]
fn the_embodiment_reaches_the_environments() {
    let options = StreamOptions::parse_from(["continual_stream", "--embodiment", "hand"]);
    assert_eq!(options.experiment().envs.embodiment, Embodiment::Hand);
}

fn stream(size: usize) -> Stream {
    let settings = VecEnvSettings {
        num_envs: 2,
        camera: Camera {
            size,
            ..Camera::default()
        },
        ..VecEnvSettings::default()
    };
    Stream::new(settings, TaskGroup::GoalReach).unwrap()
}

#[test]
fn an_image_size_that_breaks_exactness_is_refused_with_the_rule() {
    let message = Covers::new(CoversSettings::default(), stream(44).spec())
        .err()
        .unwrap()
        .to_string();
    assert!(
        message.contains("44") && message.contains("16"),
        "{message}"
    );
}

#[test]
fn a_rollout_that_does_not_fit_the_environments_is_refused() {
    let settings = CoversSettings {
        rollout_steps: 7,
        ..CoversSettings::default()
    };
    let message = Covers::new(settings, stream(16).spec())
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("`rollout_steps` is 7"), "{message}");
}

//! Small runs, runs that a crash ends, and the files that equal runs have in common.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use covers::presets::{Budget, Method};
use covers::{CoversSettings, Experiment, LearnerSettings, Run};
use envs::{Camera, Embodiment};

/// A smoke run of two groups without an arm, which takes less time; the paper's method with small
/// pictures.
pub fn two_groups(method: Method) -> Experiment {
    let mut experiment = Budget::Smoke.preset_experiment(method);
    experiment = experiment.with_embodiment(Embodiment::FLOATING_HAND);
    experiment.schedule.groups.truncate(2);
    if method == Method::Paper
        && let LearnerSettings::Covers(settings) = &mut experiment.learner
    {
        settings.network = CoversSettings::default().network;
        experiment.envs.camera.size = Camera::default().size;
    }
    experiment
}

/// Learns from this many rollouts, evaluates where that is due, and drops the run as a crash would.
pub fn crash_after(rollouts: usize, mut run: Run) -> PathBuf {
    while run.stats().rollouts < rollouts {
        run.advance().unwrap();
    }
    run.folder().path().to_owned()
}

/// All checkpoints, the oldest first.
pub fn checkpoints(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder.join("checkpoints")).unwrap();
    let mut files: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    files.sort();
    files
}

/// Newest checkpoint.
pub fn newest(folder: &Path) -> PathBuf {
    checkpoints(folder).pop().unwrap()
}

/// The tables of a run that hold no clock time.
pub const TABLES: [&str; 4] = ["metrics.csv", "evaluation.csv", "units.csv", "recognition.csv"];

/// Files that equal runs write equally: tables, and the last checkpoint, which holds the final
/// weights.
pub type Bytes = BTreeMap<PathBuf, Vec<u8>>;

/// Reads these files of a run.
pub fn bytes(folder: &Path) -> Bytes {
    let newest = newest(folder).strip_prefix(folder).unwrap().to_owned();
    let files = TABLES.map(PathBuf::from).into_iter().chain([newest]);
    let read = |file: PathBuf| (file.clone(), fs::read(folder.join(file)).unwrap());
    files.map(read).collect()
}

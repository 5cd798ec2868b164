//! Two processes on one folder, runs that are over, files that disappear, and clocks.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use covers::list::ListRunsOptions;
use covers::presets::Method;
use covers::{Provenance, Run, RunError};
use envs::Embodiment;

use crate::common::{
    Scratch, TABLES, assert_same, begun, bytes, contents, crash_after, expected, finish,
    interrupted, tiny,
};

#[test]
fn a_second_writer_is_refused_and_told_of_the_first() {
    let scratch = Scratch::new("writers");
    let mut run = Run::start(tiny(Method::Covers), scratch.run("run")).unwrap();
    run.advance().unwrap();
    let folder = run.folder().clone();
    let refusals = [
        Run::resume(folder.path(), None).err(),
        Run::start(tiny(Method::Covers), folder.clone()).err(),
        Run::start(tiny(Method::Covers), folder.clone().allow_overwriting()).err(),
    ];
    for error in refusals.map(Option::unwrap) {
        let message = error.to_string();
        let process = format!("process {}", std::process::id());
        let path = folder.path().to_str().unwrap();
        assert!(matches!(error, RunError::Locked { .. }), "{message}");
        assert!(message.contains(&process) && message.contains(path), "{message}");
    }
    assert!(listed(folder.path()).contains("running, "));
    drop(run);
    assert!(listed(folder.path()).contains("stopped at "));
    let mut second = Run::resume(folder.path(), None).unwrap();
    assert!(second.advance().unwrap().is_some(), "the first writer is gone");
}

/// Returns the list that `covers list` prints.
fn listed(folder: &Path) -> String {
    let mut out = Vec::new();
    ListRunsOptions { folder: folder.to_owned() }.run(&mut out).unwrap();
    String::from_utf8(out).unwrap()
}

#[test]
fn a_run_that_cannot_be_read_is_listed_with_the_reason() {
    let scratch = Scratch::new("unreadable");
    let (run, folder) = begun(&scratch);
    drop(run);
    fs::write(folder.join("metrics.csv"), "decisions\nmany\n").unwrap();
    let text = listed(&folder);
    assert!(text.contains("unreadable") && text.contains("metrics.csv"), "{text}");
}

/// A file server that lost a client grants the client's lock to another one. Here the lock file is
/// replaced, so that the system's lock on it is free.
fn lose_lock(folder: &Path) {
    fs::remove_file(folder.join("lock")).unwrap();
}

#[test]
fn a_writer_that_was_frozen_while_another_one_finished_changes_nothing() {
    let scratch = Scratch::new("frozen");
    let (mut frozen, folder) = begun(&scratch);
    lose_lock(&folder);
    let mut run = Run::resume(&folder, Some(1)).unwrap();
    while run.advance().unwrap().is_some() {}
    run.summary().unwrap().unwrap();
    assert_same(&bytes(&folder), expected());
    drop(run);
    let before = contents(&folder);
    let error = frozen.advance().unwrap_err();
    assert!(matches!(error, RunError::TakenOver(_)), "{error}");
    let message = error.to_string();
    let process = format!("was taken over by process {}", std::process::id());
    assert!(message.contains(&process), "{message}");
    assert!(frozen.save_checkpoint().is_err());
    drop(frozen);
    assert!(contents(&folder) == before, "the frozen writer changed a file");
}

/// Clones of a run's folder outlive the run.
#[test]
fn a_folder_of_a_run_that_ended_serves_the_next_one() {
    let scratch = Scratch::new("clones");
    let (run, _) = begun(&scratch);
    let folder = run.folder().clone();
    drop(run);
    let fresh = Run::start(tiny(Method::Covers), folder.allow_overwriting()).unwrap();
    assert_same(&finish(fresh), expected());
}

#[test]
fn a_writer_whose_folder_was_moved_away_leaves_its_successor_alone() {
    let scratch = Scratch::new("moved");
    let (mut first, folder) = begun(&scratch);
    let aside = scratch.0.join("aside");
    fs::rename(&folder, &aside).unwrap();
    let message = first.advance().unwrap_err().to_string();
    assert!(message.contains("was moved"), "{message}");
    assert!(!folder.exists(), "nothing was written in the old place");
    drop(first);
    // the run itself has lost nothing that its checkpoint holds
    assert_same(&finish(Run::resume(&aside, Some(1)).unwrap()), expected());
}

#[test]
fn tables_that_change_after_the_end_are_found_and_restored() {
    let scratch = Scratch::new("edited");
    let mut run = Run::start(tiny(Method::Covers), scratch.run("run")).unwrap();
    while run.advance().unwrap().is_some() {}
    run.summary().unwrap().unwrap();
    let folder = run.folder().clone();
    drop(run);
    folder.verify_table_checksums().unwrap();
    for file in ["metrics.csv", "evaluation.csv", "timings.csv"] {
        let path = folder.path().join(file);
        let whole = fs::read(&path).unwrap();
        // one digit of the last row, and a table that lost its tail
        let mut edited = whole.clone();
        let digit = edited.iter_mut().rev().find(|byte| byte.is_ascii_digit());
        *digit.unwrap() ^= 1;
        for changed in [&edited[..], &whole[..whole.len() - 7]] {
            fs::write(&path, changed).unwrap();
            let message = folder.verify_table_checksums().unwrap_err().to_string();
            assert!(message.contains(file) && message.contains("covers resume"), "{message}");
            Run::resume(folder.path(), Some(1)).unwrap().summary().unwrap();
            folder.verify_table_checksums().unwrap();
            assert!(fs::read(&path).unwrap() == whole);
        }
    }
    assert_same(&bytes(folder.path()), expected());
    // without a checkpoint there is nothing to restore from, and nothing starts again
    fs::remove_dir_all(folder.checkpoint_folder()).unwrap();
    let metrics = fs::read(folder.path().join("metrics.csv")).unwrap();
    let message = Run::resume(folder.path(), Some(1)).err().unwrap().to_string();
    assert!(message.contains("its checkpoints were removed"), "{message}");
    assert_eq!(fs::read(folder.path().join("metrics.csv")).unwrap(), metrics);
}

#[test]
fn a_finished_run_is_overwritten_only_when_told() {
    let scratch = Scratch::new("finished");
    let experiment = tiny(Method::Covers);
    let folder = scratch.run("run");
    let expected = finish(Run::start(experiment.clone(), folder.clone()).unwrap());
    let error = Run::start(experiment.clone(), folder.clone()).err().unwrap();
    assert!(matches!(error, RunError::FolderHoldsRun { .. }), "{error}");
    assert!(error.to_string().contains("covers resume"), "{error}");
    // what has ended stays as it is
    let lines = Provenance::read(folder.path()).unwrap().len();
    assert_same(&finish(Run::resume(folder.path(), None).unwrap()), &expected);
    assert_eq!(Provenance::read(folder.path()).unwrap().len(), lines);
    fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    let folder = folder.allow_overwriting();
    let other = finish(Run::start(experiment.with_seed(9), folder.clone()).unwrap());
    assert!(other[Path::new("metrics.csv")] != expected[Path::new("metrics.csv")]);
    let notes = fs::read_to_string(folder.path().join("notes.txt")).unwrap();
    assert_eq!(notes, "mine");
}

#[test]
fn a_file_that_a_run_would_replace_is_kept_unless_told() {
    let scratch = Scratch::new("foreign");
    let folder = scratch.run("project");
    fs::create_dir_all(folder.path()).unwrap();
    let own = folder.path().join("log.txt");
    fs::write(&own, "mine").unwrap();
    let error = Run::start(tiny(Method::Covers), folder.clone()).err().unwrap();
    assert!(error.to_string().contains("log.txt exists already"), "{error}");
    assert_eq!(fs::read_to_string(&own).unwrap(), "mine");
    Run::start(tiny(Method::Covers), folder.allow_overwriting()).unwrap();
    assert_ne!(fs::read_to_string(&own).unwrap(), "mine");
}

#[test]
fn files_that_are_removed_or_cut_while_the_run_goes_on_come_back_whole() {
    let scratch = Scratch::new("removed");
    let (run, folder) = begun(&scratch);
    for file in TABLES.iter().chain(&["timings.csv"]) {
        fs::remove_file(folder.join(file)).unwrap();
    }
    fs::write(folder.join("units.csv"), "roll").unwrap();
    let written = finish(run);
    assert_same(&written, expected());
    let metrics = &written[Path::new("metrics.csv")];
    assert_eq!(rollouts(&timings(&folder)), rollouts(metrics));
}

#[test]
fn rows_that_are_lost_while_no_process_runs_come_back_from_the_checkpoint() {
    let scratch = Scratch::new("rows");
    let folder = interrupted(&scratch);
    let metrics = folder.join("metrics.csv");
    let whole = fs::read(&metrics).unwrap();
    fs::write(&metrics, &whole[..whole.len() / 2]).unwrap();
    for file in ["units.csv", "recognition.csv", "timings.csv", "log.txt"] {
        fs::remove_file(folder.join(file)).unwrap();
    }
    let written = finish(Run::resume(&folder, Some(1)).unwrap());
    assert_same(&written, expected());
    // timings come from their copy; the log begins anew
    assert_eq!(rollouts(&timings(&folder)), rollouts(&written[Path::new("metrics.csv")]));
    let log = fs::read_to_string(folder.join("log.txt")).unwrap();
    assert!(log.contains("continues after 3 rollouts"), "{log}");
}

fn timings(folder: &Path) -> Vec<u8> {
    fs::read(folder.join("timings.csv")).unwrap()
}

/// The first column of a table, without its name.
fn rollouts(table: &[u8]) -> Vec<usize> {
    let text = str::from_utf8(table).unwrap();
    let first = |row: &str| row.split(',').next().unwrap().parse().unwrap();
    text.lines().skip(1).map(first).collect()
}

#[test]
fn provenance_says_who_worked_on_a_run() {
    let scratch = Scratch::new("provenance");
    let folder = crash_after(2, Run::start(tiny(Method::Covers), scratch.run("run")).unwrap());
    finish(Run::resume(&folder, Some(1)).unwrap());
    let [first, second] = &Provenance::read(&folder).unwrap()[..] else {
        panic!("two processes worked on the run");
    };
    assert_eq!((first.rollouts_before, second.rollouts_before), (0, 2));
    assert_eq!((first.threads, second.threads), (2, 1));
    assert_eq!(first.mujoco_version, envs::mujoco::library_version());
    assert!(first.renderer.contains("OpenGL"), "{}", first.renderer);
    assert!(!first.command.is_empty() && first.covers_version == env!("CARGO_PKG_VERSION"));
    assert_eq!(first.commit.is_some(), first.clean_checkout.is_some());
}

/// Another process reads the file of the arm again.
#[test]
fn a_run_whose_robot_has_changed_is_refused() {
    let scratch = Scratch::new("robot");
    let arm = include_str!("../../assets/urdf/five_joint_hobby.urdf");
    let path = scratch.0.join("arm.urdf");
    fs::write(&path, arm).unwrap();
    let experiment = tiny(Method::Covers).with_embodiment(Embodiment::from_file(&path).unwrap());
    let folder = crash_after(1, Run::start(experiment, scratch.run("run")).unwrap());
    let covers = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_covers"));
        let ended = command.args(arguments).arg(&folder).output().unwrap();
        (ended.status.code(), String::from_utf8(ended.stderr).unwrap())
    };
    assert_eq!(covers(&["eval", "--episodes", "16"]).0, Some(0));
    fs::write(&path, arm.replace("<mass value=\"0.969\"/>", "<mass value=\"0.9\"/>")).unwrap();
    let film = scratch.0.join("film.gif");
    let render = ["render", "--out", film.to_str().unwrap()];
    for command in [&["resume"][..], &["eval"], &render] {
        let (code, said) = covers(command);
        assert_eq!(code, Some(1), "{said}");
        assert!(said.contains("arm.urdf describes has changed since the run"), "{said}");
    }
}

/// Seconds are differences of a clock that never goes back (`Instant`), so a machine's clock that
/// is set back changes nothing but the date in the provenance.
#[test]
fn the_machines_clock_is_read_in_one_place_alone() {
    fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                sources(&path, found);
            } else if fs::read_to_string(&path).is_ok_and(|text| text.contains("SystemTime::now")) {
                found.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let folders = fs::read_dir(root).unwrap().map(|entry| entry.unwrap().path().join("src"));
    let folders: Vec<_> = folders.chain([root.join("src")]).filter(|path| path.is_dir()).collect();
    assert!(folders.len() > 15, "{folders:?}");
    folders.iter().for_each(|folder| sources(folder, &mut found));
    assert_eq!(found, [root.join("experiments/src/provenance.rs")]);
}

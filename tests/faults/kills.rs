//! `kill -9` at any moment, also inside the write of a checkpoint.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use covers::presets::Method;
use covers::{Experiment, RunFolder};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{Bytes, Scratch, assert_same, bytes, expected, full, reference, tiny};

fn covers(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_covers"))
        .args(arguments)
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

/// When a process is killed.
#[derive(Clone, Copy)]
enum Moment {
    /// After this time.
    After(Duration),
    /// When it has begun to write this many files under a temporary name.
    Writing(usize),
}

/// Waits for the moment and kills the process; true where it had ended before.
fn kill(mut process: Child, folder: &Path, moment: Moment) -> bool {
    let clock = Instant::now();
    let (mut seen, mut there) = (0, false);
    loop {
        if let Some(status) = process.try_wait().unwrap() {
            assert!(status.success(), "{status}");
            return true;
        }
        let was_there = there;
        there = partial_exists(folder);
        seen += usize::from(there && !was_there);
        let now = match moment {
            Moment::After(time) => clock.elapsed() >= time,
            Moment::Writing(nth) => there && seen >= nth,
        };
        if now {
            break;
        }
        sleep(Duration::from_micros(200));
    }
    process.kill().unwrap();
    process.wait().unwrap();
    false
}

/// Whether a checkpoint is being written.
fn partial_exists(folder: &Path) -> bool {
    let files = fs::read_dir(folder.join("checkpoints"));
    let mut names = files.into_iter().flatten().flatten();
    names.any(|file| {
        file.path()
            .extension()
            .is_some_and(|ending| ending == "partial")
    })
}

/// Removes what the last kill left, so that the next one is seen.
fn remove_partial(folder: &Path) {
    for file in fs::read_dir(folder.join("checkpoints"))
        .into_iter()
        .flatten()
    {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "partial") {
            fs::remove_file(path).unwrap();
        }
    }
}

/// Kills the run again and again, each time after a moment that is drawn, until it ends or was
/// killed `kills` times; returns the number of kills, and of those inside a checkpoint's write.
fn torment(folder: &Path, config: &str, kills: usize, rng: &mut ChaCha8Rng) -> (usize, usize) {
    let path = folder.to_str().unwrap();
    let (mut killed, mut writing) = (0, 0);
    loop {
        let threads = ["1", "2"][rng.random_range(0..2)];
        remove_partial(folder);
        let process = if RunFolder::open(folder).holds_run() {
            covers(&["resume", path, "--threads", threads])
        } else {
            covers(&[
                "train",
                "--config",
                config,
                "--folder",
                path,
                "--threads",
                threads,
            ])
        };
        let moment = match (killed < kills, rng.random_range(0..2)) {
            (false, _) => Moment::After(Duration::from_secs(3600)),
            (true, 0) => Moment::After(Duration::from_millis(rng.random_range(0..1500))),
            (true, _) => Moment::Writing(rng.random_range(1..3)),
        };
        if kill(process, folder, moment) {
            return (killed, writing);
        }
        killed += 1;
        writing += usize::from(partial_exists(folder));
    }
}

/// Writes the settings where `covers train --config` reads them.
fn config(scratch: &Scratch, experiment: &Experiment) -> String {
    let path = scratch.0.join("settings.json");
    fs::write(&path, serde_json::to_string(experiment).unwrap()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn survives(
    scratch: &Scratch,
    experiment: &Experiment,
    kills: usize,
    expected: &Bytes,
) -> (usize, usize) {
    let config = config(scratch, experiment);
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let (mut killed, mut writing, mut run) = (0, 0, 0);
    while killed < kills {
        let folder = scratch.0.join(format!("run-{run}"));
        let (k, w) = torment(&folder, &config, kills - killed, &mut rng);
        assert_same(&bytes(&folder), expected);
        (killed, writing, run) = (killed + k, writing + w, run + 1);
        fs::remove_dir_all(&folder).unwrap();
    }
    (killed, writing)
}

#[test]
fn a_run_that_is_killed_again_and_again_writes_the_same_bytes() {
    let scratch = Scratch::new("kills");
    let kills = if full() { 200 } else { 4 };
    let (killed, writing) = survives(&scratch, &tiny(Method::Covers), kills, expected());
    println!("{killed} kills, {writing} of them inside the write of a checkpoint");
    assert!(killed >= kills);
    assert!(!full() || writing >= 50, "{writing}");
}

#[test]
fn every_method_survives_kills() {
    if !full() {
        return;
    }
    for method in Method::ALL {
        let scratch = Scratch::new(method.name());
        let experiment = tiny(method);
        let expected = reference(&experiment);
        let (killed, _) = survives(&scratch, &experiment, 6, &expected);
        println!("{}: {killed} kills", method.name());
    }
}

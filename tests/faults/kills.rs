//! `kill -9` at any moment, also inside the write of a checkpoint, hang-ups and closed outputs.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use covers::presets::Method;
use covers::{Experiment, RunFolder};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{Bytes, Scratch, assert_same, bytes, expected, full, reference, tiny};

fn covers(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_covers"))
        .args(arguments)
        .stdout(Stdio::piped())
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

/// Way in which a process ends.
#[derive(Clone, Copy, PartialEq)]
enum Cause {
    Kill,
    HangUp,
    ClosedOutput,
}

/// How a process ended.
enum End {
    ByItself,
    Early {
        /// Killed inside the write of a checkpoint.
        writing: bool,
    },
}

/// Waits for the moment and ends the process, unless it ends before.
fn end(mut process: Child, folder: &Path, moment: Moment, cause: Cause) -> End {
    let clock = Instant::now();
    // what an earlier kill left is no write of this process
    let before = partials(folder);
    let is_writing = || partials(folder).iter().any(|file| !before.contains(file));
    let (mut seen, mut there) = (0, false);
    loop {
        if let Some(status) = process.try_wait().unwrap() {
            assert!(status.success(), "{status}");
            return End::ByItself;
        }
        let was_there = there;
        there = is_writing();
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
    match cause {
        Cause::Kill => process.kill().unwrap(),
        Cause::HangUp => {
            let id = process.id().to_string();
            Command::new("kill").args(["-s", "HUP", &id]).status().unwrap();
        }
        Cause::ClosedOutput => drop(process.stdout.take()),
    }
    let status = process.wait().unwrap();
    let writing = cause == Cause::Kill && is_writing();
    // a hang-up may come before the process handles it
    let expected = match cause {
        Cause::Kill => [None, None],
        Cause::HangUp => [None, Some(3)],
        Cause::ClosedOutput => [Some(3); 2],
    };
    let finished = RunFolder::from_path(folder).is_finished();
    assert!(finished || expected.contains(&status.code()), "{status}");
    // a signal that ends a process at once may do so before a row of an earlier process is removed
    let (lost, at_once) = (lost_rollouts(folder), status.code().is_none());
    assert!(lost <= usize::from(at_once), "{lost} rollouts are lost: {status}");
    End::Early { writing }
}

/// The rollouts of the table of metrics that no checkpoint holds.
fn lost_rollouts(folder: &Path) -> usize {
    let metrics = fs::read_to_string(folder.join("metrics.csv")).unwrap_or_default();
    let rollouts = metrics.matches('\n').count().saturating_sub(1);
    let files = fs::read_dir(folder.join("checkpoints")).into_iter().flatten().flatten();
    let number = |file: fs::DirEntry| {
        let name = file.file_name().into_string().unwrap();
        name.strip_suffix(".safetensors")?.parse().ok()
    };
    rollouts.saturating_sub(files.filter_map(number).max().unwrap_or(0))
}

/// The checkpoints that are not whole, and when each was changed.
fn partials(folder: &Path) -> Vec<(PathBuf, SystemTime)> {
    let files = fs::read_dir(folder.join("checkpoints"));
    let files = files.into_iter().flatten().flatten();
    let partial = files.filter(|file| file.path().extension() == Some(OsStr::new("partial")));
    // one that is renamed meanwhile is whole
    let dated = |file: fs::DirEntry| Some((file.path(), file.metadata().ok()?.modified().ok()?));
    partial.filter_map(dated).collect()
}

/// Leaves the half of a checkpoint that no later one replaces: the next process has to remove it.
fn leave_half(folder: &Path) {
    let checkpoints = folder.join("checkpoints");
    if checkpoints.is_dir() {
        fs::write(checkpoints.join("999999.safetensors.partial"), "half").unwrap();
    }
}

/// Ends the run again and again, each time after a moment that is drawn, until it ends by itself or
/// was ended `kills` times; returns this number, and that of kills inside a checkpoint's write.
fn torment(folder: &Path, config: &str, kills: usize, rng: &mut ChaCha8Rng) -> (usize, usize) {
    let path = folder.to_str().unwrap();
    let (mut killed, mut writes) = (0, 0);
    loop {
        let threads = ["1", "2"][rng.random_range(0..2)];
        let what = if RunFolder::from_path(folder).holds_run() {
            vec!["resume", path]
        } else {
            vec!["train", "--config", config, "--folder", path]
        };
        let process = covers(&[&what[..], &["--threads", threads]].concat());
        let moment = match (killed < kills, rng.random_range(0..2)) {
            (false, _) => Moment::After(Duration::from_secs(3600)),
            (true, 0) => Moment::After(Duration::from_millis(rng.random_range(0..1000))),
            (true, _) => Moment::Writing(rng.random_range(1..3)),
        };
        let causes = [Cause::Kill, Cause::Kill, Cause::HangUp, Cause::ClosedOutput];
        match end(process, folder, moment, causes[rng.random_range(0..causes.len())]) {
            End::ByItself => break,
            End::Early { writing } => {
                killed += 1;
                writes += usize::from(writing);
                leave_half(folder);
            }
        }
    }
    let left = partials(folder);
    assert!(left.is_empty(), "{left:?}");
    (killed, writes)
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
    println!("{killed} ends, {writing} of them kills inside the write of a checkpoint");
    assert!(killed >= kills);
    assert!(!full() || writing >= 25, "{writing}");
}

#[test]
fn every_method_survives_kills() {
    let (methods, kills) = if full() {
        (&Method::ALL[..], 6)
    } else {
        (&[Method::CoversGt, Method::ThreeRl, Method::EquiSac][..], 1)
    };
    for &method in methods {
        let scratch = Scratch::new(method.name());
        let mut experiment = tiny(method);
        experiment.evaluation.recognition_repeats = 1;
        let expected = reference(&experiment);
        let (killed, _) = survives(&scratch, &experiment, kills, &expected);
        println!("{}: {killed} ends", method.name());
        assert!(killed >= kills);
    }
}

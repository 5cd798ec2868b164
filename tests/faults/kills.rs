//! `kill -9` at any moment, also inside the write of a checkpoint.

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

/// How a process ended.
enum End {
    ByItself,
    Killed {
        /// Inside the write of a checkpoint.
        writing: bool,
    },
}

/// Waits for the moment and kills the process, unless it ends before.
fn kill(mut process: Child, folder: &Path, moment: Moment) -> End {
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
    process.kill().unwrap();
    process.wait().unwrap();
    let writing = is_writing();
    End::Killed { writing }
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

/// Kills the run again and again, each time after a moment that is drawn, until it ends or was
/// killed `kills` times; returns the number of kills, and of those inside a checkpoint's write.
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
        match kill(process, folder, moment) {
            End::ByItself => break,
            End::Killed { writing } => {
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
    println!("{killed} kills, {writing} of them inside the write of a checkpoint");
    assert!(killed >= kills);
    assert!(!full() || writing >= 50, "{writing}");
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
        println!("{}: {killed} kills", method.name());
        assert!(killed >= kills);
    }
}

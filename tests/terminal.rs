//! Screens on a terminal, and what becomes of who draws on it when it goes away. The terminal is
//! not the one that controls the session, so no signal says that it is gone.

use std::fs::{self, File, OpenOptions};
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::thread::sleep;
use std::time::{Duration, Instant};

use covers::presets::Method;
use covers::{Run, RunFolder};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

use crate::common::packed::small;
use crate::common::scratch::Scratch;

/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// Starts `covers` on a terminal, and waits until it has drawn something.
fn on_terminal(arguments: &[&str]) -> (File, Child) {
    // a child that held the owner's side would keep its own terminal alive
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let owner = openpt(flags).unwrap();
    grantpt(&owner).unwrap();
    unlockpt(&owner).unwrap();
    let name = ptsname(&owner, Vec::new()).unwrap();
    let name = Path::new(name.to_str().unwrap());
    let side = || OpenOptions::new().read(true).write(true).open(name);
    let child = Command::new(env!("CARGO_BIN_EXE_covers"))
        .args(arguments)
        .env("TERM", "xterm-256color")
        .stdin(side().unwrap())
        .stdout(side().unwrap())
        .stderr(side().unwrap())
        .spawn()
        .unwrap();
    let mut owner = File::from(owner);
    let mut drawn = vec![0; 4096];
    assert!(owner.read(&mut drawn).unwrap() > 0);
    (owner, child)
}

/// Waits until a process ends, and ends it where it does not.
fn end(mut child: Child) -> ExitStatus {
    let clock = Instant::now();
    while clock.elapsed() < PATIENCE {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    panic!("it goes on without its terminal");
}

#[test]
fn a_watcher_ends_with_its_terminal() {
    let scratch = Scratch::new("hang-up");
    let folder = RunFolder::create(&scratch.0, "run").unwrap();
    let path = folder.path().to_str().unwrap().to_owned();
    drop(Run::start(small(Method::Equi), folder).unwrap());
    let (owner, child) = on_terminal(&["watch", &path]);
    drop(owner);
    assert_eq!(end(child).code(), Some(1));
}

#[test]
fn a_run_ends_with_its_terminal_and_leaves_a_checkpoint() {
    let scratch = Scratch::new("hang-up-train");
    let mut experiment = small(Method::Equi);
    experiment.schedule.cycles = 1000;
    experiment.checkpoints.every = 1_000_000;
    let config = scratch.0.join("settings.json");
    fs::write(&config, serde_json::to_string(&experiment).unwrap()).unwrap();
    let run = scratch.0.join("run");
    let (config, folder) = (config.to_str().unwrap(), run.to_str().unwrap());
    let (owner, child) = on_terminal(&["train", "--tui", "--config", config, "--folder", folder]);
    let metrics = || fs::read_to_string(run.join("metrics.csv")).unwrap_or_default();
    let clock = Instant::now();
    while metrics().lines().count() < 3 && clock.elapsed() < PATIENCE {
        sleep(Duration::from_millis(20));
    }
    let begun = metrics().lines().count() >= 3;
    drop(owner);
    assert_eq!(end(child).code(), Some(1));
    assert!(begun, "no rollouts within {PATIENCE:?}");
    let saved = fs::read_dir(run.join("checkpoints")).unwrap().next();
    let name = saved.unwrap().unwrap().file_name().into_string().unwrap();
    // a header, and a row a rollout
    let rollouts = metrics().lines().count() - 1;
    assert_eq!(name, format!("{rollouts:06}.safetensors"));
}

//! A sweep whose workers are killed, and one that several workers share.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use covers::sweep::Plan;

use crate::common::{Scratch, assert_same, bytes, reference};

const PLAN: &str = r#"{
    "methods": ["covers", "equi"],
    "seeds": [1000],
    "budget": "smoke",
    "set": ["envs.embodiment=hand", "schedule.cycles=1", "checkpoints.every=1",
        "schedule.groups=[{\"group\": \"goal-reach\", \"decisions\": 320, \"variants\": [\"identity\"]}]"]
}"#;

fn worker(plan: &Path, runs: &Path) -> Child {
    let (plan, runs) = (plan.to_str().unwrap(), runs.to_str().unwrap());
    Command::new(env!("CARGO_BIN_EXE_covers"))
        .args(["sweep", plan, "--runs", runs])
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

#[test]
fn workers_that_are_killed_leave_jobs_that_others_finish() {
    let scratch = Scratch::new("sweep");
    let (plan, runs) = (scratch.0.join("plan.json"), scratch.0.join("runs"));
    fs::write(&plan, PLAN).unwrap();
    let mut workers = [worker(&plan, &runs), worker(&plan, &runs)];
    sleep(Duration::from_millis(1200));
    workers[0].kill().unwrap();
    for worker in &mut workers {
        worker.wait().unwrap();
    }
    assert!(worker(&plan, &runs).wait().unwrap().success());
    for job in Plan::read(&plan).unwrap().jobs().unwrap() {
        assert_same(&bytes(&job.folder(&runs)), &reference(&job.experiment));
    }
    let other = PLAN.replace("decisions\\\": 320", "decisions\\\": 400");
    assert_ne!(other, PLAN);
    fs::write(&plan, other).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_covers"))
        .args([
            "sweep",
            plan.to_str().unwrap(),
            "--runs",
            runs.to_str().unwrap(),
        ])
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains("other settings"), "{said}");
}

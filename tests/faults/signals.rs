//! Ctrl-C and SIGTERM: the first ends a run in good order, the second at once.

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};

use covers::Experiment;
use covers::presets::Method;

use crate::common::{Scratch, assert_same, bytes, reference, tiny};

/// A process, and what it prints.
struct Process {
    child: Child,
    out: BufReader<ChildStdout>,
}

impl Process {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_covers"));
        let command = command.args(arguments).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let out = BufReader::new(child.stdout.take().unwrap());
        Self { child, out }
    }

    /// Reads until a line contains `part`.
    fn wait_for(&mut self, part: &str) -> String {
        loop {
            let mut line = String::new();
            assert!(
                self.out.read_line(&mut line).unwrap() > 0,
                "no line has {part}"
            );
            if line.contains(part) {
                return line;
            }
        }
    }

    fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let status = Command::new("kill").args(["-s", name, &id]).status();
        assert!(status.unwrap().success());
    }

    /// The exit code.
    fn end(mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }
}

fn train(scratch: &Scratch, experiment: &Experiment) -> Process {
    let config = scratch.0.join("settings.json");
    std::fs::write(&config, serde_json::to_string(experiment).unwrap()).unwrap();
    let folder = scratch.0.join("run");
    let (config, folder) = (config.to_str().unwrap(), folder.to_str().unwrap());
    Process::start(&["train", "--config", config, "--folder", folder])
}

/// Sends the signal after the first rollout, waits for the end, and lets the run go on.
fn stop_after_a_rollout(scratch: &Scratch, experiment: &Experiment, signal: &str) -> String {
    let mut process = train(scratch, experiment);
    process.wait_for("policy 0");
    process.signal(signal);
    let said = process.wait_for("stopped after");
    assert_eq!(process.end(), Some(3));
    goes_on(scratch, experiment);
    said
}

fn goes_on(scratch: &Scratch, experiment: &Experiment) {
    let folder = scratch.0.join("run");
    let resumed = Process::start(&["resume", folder.to_str().unwrap(), "--threads", "1"]);
    // all that it prints, so that it never waits for a reader
    let lines: Vec<String> = resumed.out.lines().map(Result::unwrap).collect();
    assert!(lines[0].contains("goes on after"), "{}", lines[0]);
    assert_same(&bytes(&folder), &reference(experiment));
}

#[test]
fn a_signal_ends_the_rollout_and_leaves_a_checkpoint() {
    for signal in ["INT", "TERM"] {
        let scratch = Scratch::new(signal);
        let mut experiment = tiny(Method::Covers);
        // no checkpoint but the one that the signal asks for
        experiment.checkpoints.every = 100;
        let said = stop_after_a_rollout(&scratch, &experiment, signal);
        assert!(said.contains("covers resume"), "{said}");
    }
}

#[test]
fn a_signal_within_an_evaluation_does_not_wait_for_its_end() {
    let scratch = Scratch::new("evaluation");
    let mut experiment = tiny(Method::Covers);
    experiment.evaluation.visit_rounds = 2;
    experiment
        .schedule
        .groups
        .iter_mut()
        .for_each(|plan| plan.decisions = 80);
    // the evaluation after the first visit has begun or is about to
    let said = stop_after_a_rollout(&scratch, &experiment, "INT");
    assert!(said.contains("stopped after 1 rollouts"), "{said}");
}

#[test]
fn a_second_signal_ends_the_process_at_once_and_the_last_checkpoint_is_whole() {
    let scratch = Scratch::new("twice");
    let mut experiment = tiny(Method::Covers);
    experiment.evaluation.rounds = 3;
    let mut process = train(&scratch, &experiment);
    process.wait_for("policy 0");
    process.wait_for("policy ");
    process.signal("INT");
    process.signal("INT");
    let code = process.end();
    // the first signal may have been served before the second came
    assert!(code == Some(130) || code == Some(3), "{code:?}");
    goes_on(&scratch, &experiment);
}

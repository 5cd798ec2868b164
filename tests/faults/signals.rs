//! Signals and closed outputs: they end a run in good order. The second Ctrl-C or SIGTERM ends it
//! at once.

use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use covers::presets::Method;
use covers::{Experiment, LearnerSettings, Run};

use crate::common::{Bytes, Scratch, assert_same, bytes, finish, reference, tiny};

/// A process, and what it prints.
struct Process {
    child: Child,
    out: BufReader<ChildStdout>,
}

impl Process {
    fn start<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> Self {
        Self::of(Command::new(env!("CARGO_BIN_EXE_covers")).args(arguments))
    }

    fn of(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let out = BufReader::new(child.stdout.take().unwrap());
        Self { child, out }
    }

    /// Reads until a line contains `part`.
    fn wait_for(&mut self, part: &str) -> String {
        self.wait_until(|line| line.contains(part))
    }

    /// Reads until the row of a rollout, which begins with a number in a column of its own.
    fn wait_for_rollout(&mut self) {
        let begins = |line: &str| line.trim_start().starts_with(|c: char| c.is_ascii_digit());
        self.wait_until(|line| line.starts_with(' ') && begins(line));
    }

    fn wait_until(&mut self, found: impl Fn(&str) -> bool) -> String {
        let mut said = String::new();
        loop {
            let start = said.len();
            assert!(self.out.read_line(&mut said).unwrap() > 0, "no such line: {said}");
            if found(&said[start..]) {
                return said.split_off(start);
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
    Process::start(train_arguments(scratch, experiment))
}

fn train_arguments(scratch: &Scratch, experiment: &Experiment) -> [OsString; 5] {
    let config = scratch.0.join("settings.json");
    std::fs::write(&config, serde_json::to_string(experiment).unwrap()).unwrap();
    let folder = scratch.0.join("run").into();
    ["train".into(), "--config".into(), config.into(), "--folder".into(), folder]
}

/// Sends a signal after the first rollout; returns the line that names the command to continue.
fn stop_in_rollout(mut process: Process, signal: &str) -> String {
    process.wait_for_rollout();
    stop(process, signal)
}

fn stop(mut process: Process, signal: &str) -> String {
    process.signal(signal);
    let said = process.wait_for("stopped after");
    assert_eq!(process.end(), Some(3));
    said
}

/// A folder, and a short run of COVERS that is changed by `adapt`.
fn prepared(name: &str, adapt: impl FnOnce(&mut Experiment)) -> (Scratch, Experiment) {
    let mut experiment = tiny(Method::Covers);
    adapt(&mut experiment);
    (Scratch::new(name), experiment)
}

/// Makes a run so long that it does not end before a signal reaches it, on a busy machine either; no
/// checkpoint is written but the one that the signal asks for.
fn long_without_checkpoints(experiment: &mut Experiment) {
    experiment.checkpoints.every = 100;
    // the group that comes second
    experiment.schedule.groups[0].decisions = 10 * 80;
}

/// Resumes and expects what a run that nothing happened to writes.
fn goes_on(scratch: &Scratch, expected: &Bytes) {
    let folder = scratch.0.join("run");
    let resumed = Process::start(["resume", folder.to_str().unwrap(), "--threads", "1"]);
    // all that it prints, so that it never waits for a reader
    let lines: Vec<String> = resumed.out.lines().map(Result::unwrap).collect();
    assert!(lines[0].contains("continues after"), "{}", lines[0]);
    assert_same(&bytes(&folder), expected);
}

#[test]
fn a_signal_ends_the_rollout_and_leaves_a_checkpoint() {
    let mut expected = None;
    for signal in ["INT", "TERM", "HUP"] {
        let (scratch, experiment) = prepared(signal, long_without_checkpoints);
        let said = stop_in_rollout(train(&scratch, &experiment), signal);
        assert!(said.contains("covers resume"), "{said}");
        goes_on(&scratch, expected.get_or_insert_with(|| reference(&experiment)));
    }
}

/// A terminal that closes may hang up more than once, and a session that ends may send SIGHUP first
/// and SIGTERM soon after.
#[test]
fn a_second_hangup_or_a_first_sigterm_after_a_hangup_changes_nothing() {
    let mut expected = None;
    for signal in ["HUP", "TERM"] {
        let (scratch, experiment) = prepared("hangups", long_without_checkpoints);
        let mut process = train(&scratch, &experiment);
        process.wait_for_rollout();
        process.signal("HUP");
        // two signals that are waiting count as one
        sleep(Duration::from_millis(20));
        process.signal(signal);
        let said = process.wait_for("stopped after");
        assert_eq!(process.end(), Some(3), "{said}");
        goes_on(&scratch, expected.get_or_insert_with(|| reference(&experiment)));
    }
}

#[test]
fn a_run_under_nohup_ignores_that_the_terminal_closes() {
    let (scratch, experiment) = prepared("nohup", |_| {});
    let arguments = train_arguments(&scratch, &experiment);
    let mut command = Command::new("nohup");
    command.arg(env!("CARGO_BIN_EXE_covers")).args(arguments);
    let mut process = Process::of(&mut command);
    process.wait_for_rollout();
    process.signal("HUP");
    process.wait_for("files:");
    assert_eq!(process.end(), Some(0));
}

#[test]
fn an_output_that_is_closed_ends_the_rollout_and_leaves_a_checkpoint() {
    let (scratch, experiment) = prepared("pipe", long_without_checkpoints);
    let mut process = train(&scratch, &experiment);
    process.wait_for_rollout();
    let Process { mut child, out } = process;
    drop(out);
    assert_eq!(child.wait().unwrap().code(), Some(3));
    goes_on(&scratch, &reference(&experiment));
}

#[test]
fn a_signal_within_an_evaluation_does_not_wait_for_its_end() {
    // policies of 3RL have a memory of the episode, and a replay
    for method in [Method::Covers, Method::ThreeRl] {
        let scratch = Scratch::new("evaluation");
        let mut experiment = tiny(method);
        experiment.evaluation.visit_episodes_per_env = 2;
        let groups = &mut experiment.schedule.groups;
        groups.iter_mut().for_each(|plan| plan.decisions = 80);
        // the evaluation after the first visit has begun or is about to, that before the stream is
        // done
        let said = stop_in_rollout(train(&scratch, &experiment), "INT");
        assert!(said.contains("stopped after 1 rollouts"), "{said}");
        let rows = std::fs::read_to_string(scratch.0.join("run/evaluation.csv")).unwrap();
        let early = rows.lines().skip(1).all(|row| row.starts_with("0,0,"));
        assert!(early && rows.lines().count() > 1, "one evaluation was broken off: {rows}");
        goes_on(&scratch, &reference(&experiment));
    }
}

#[test]
fn a_signal_within_the_episodes_of_a_variant_does_not_wait_for_their_end() {
    // the evaluation before the stream would take hours in its first variant
    let (scratch, experiment) = prepared("episodes", |experiment| {
        experiment.evaluation.visit_episodes_per_env = 10_000;
    });
    let mut process = train(&scratch, &experiment);
    process.wait_for("begun");
    sleep(Duration::from_secs(1));
    process.signal("TERM");
    let clock = Instant::now();
    assert!(process.wait_for("stopped after").contains("stopped after 0 rollouts"));
    assert_eq!(process.end(), Some(3));
    assert!(clock.elapsed() < Duration::from_secs(10), "{:?}", clock.elapsed());
}

#[test]
fn a_signal_ends_the_scoring_of_a_finished_run() {
    let (scratch, experiment) = prepared("scoring", |e| e.evaluation.episodes_per_env = 20);
    finish(Run::start(experiment, scratch.run("run")).unwrap());
    let folder = scratch.0.join("run");
    let mut resumed = Process::start(["resume", folder.to_str().unwrap()]);
    resumed.wait_for("continues after");
    let said = stop(resumed, "INT");
    assert!(said.contains("covers resume"), "{said}");
    assert!(!folder.join("summary.json").exists());
}

#[test]
fn a_second_signal_ends_the_process_at_once_and_the_last_checkpoint_is_whole() {
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let scratch = Scratch::new("twice");
        let mut experiment = tiny(Method::Covers);
        // the second rollout goes on for much longer than the signals take
        let LearnerSettings::Covers(settings) = &mut experiment.learner else {
            panic!("{:?}", experiment.learner);
        };
        settings.rollout_steps = 1600;
        let groups = &mut experiment.schedule.groups;
        groups.iter_mut().for_each(|plan| plan.decisions = 2 * 1600);
        let mut process = train(&scratch, &experiment);
        process.wait_for_rollout();
        // the second rollout has begun
        sleep(Duration::from_millis(500));
        process.signal(signal);
        // two signals that are waiting count as one
        sleep(Duration::from_millis(100));
        let ended = process.child.try_wait().unwrap();
        assert!(ended.is_none(), "the first signal waits for the rollout");
        process.signal(signal);
        assert_eq!(process.end(), Some(code));
        let run = Run::resume(&scratch.0.join("run"), Some(1)).unwrap();
        assert_eq!(run.stats().rollouts, 1, "{}", run.start_message());
    }
}

//! Numbers that are not finite and threads that panic: a named error before a checkpoint is
//! poisoned, or a failure of one environment alone.

use std::process::Command;

use covers::presets::Method;
use covers::{Experiment, Run, RunError, RunEvent};
use envs::{TaskGroup, TaskRegistry};

use crate::common::{Scratch, checkpoints, newest, tiny};
use crate::faulty::Faulty;

/// Libraries that cannot get memory end the process without an error of ours, some by SIGSEGV.
#[test]
fn a_limit_of_memory_that_is_too_low_is_an_error_and_begins_no_run() {
    let scratch = Scratch::new("memory");
    for (kibibytes, code) in
        [(200_000, 1), (400_000, 1), (600_000, 1), (800_000, 1), (1_200_000, 0)]
    {
        let folder = scratch.0.join(format!("limit-{kibibytes}"));
        let script = format!("ulimit -v {kibibytes} && exec \"$@\"");
        let output = Command::new("bash")
            .args(["-c", &script, "bash", env!("CARGO_BIN_EXE_covers"), "train"])
            .args(["--budget", "smoke", "--threads", "1", "--folder"])
            .arg(&folder)
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{kibibytes}: {message}");
        if code == 1 {
            assert!(message.contains("`ulimit -v`"), "{message}");
            assert!(!folder.join("experiment.json").exists(), "nothing began");
        }
    }
}

/// The signal of a file that is too long would end the process without a message.
#[test]
fn a_limit_of_file_sizes_is_an_error_that_names_the_file() {
    let scratch = Scratch::new("size");
    let folder = scratch.0.join("run");
    let output = Command::new("bash")
        .args(["-c", "ulimit -f 8 && exec \"$@\"", "bash", env!("CARGO_BIN_EXE_covers"), "train"])
        .args(["--budget", "smoke", "--folder"])
        .arg(&folder)
        .output()
        .unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains(folder.to_str().unwrap()), "{message}");
    assert!(message.contains("File too large"), "{message}");
}

/// One group of a task that fails after about two and a half rollouts.
fn run_of(scratch: &Scratch, task: &'static Faulty) -> Run {
    let mut tasks = TaskRegistry::with_standard();
    tasks.register(TaskGroup::from_task(task)).unwrap();
    let mut experiment = tiny(Method::Covers);
    experiment.schedule.groups.truncate(1);
    experiment.schedule.groups[0].group = envs::Task::name(task).to_owned();
    experiment.schedule.groups[0].decisions = 4 * 80;
    Run::start_with_tasks(experiment, tasks, scratch.run("run")).unwrap()
}

/// Rewards asked for in a rollout: one a control step, ten a decision, 80 decisions.
const ROLLOUT: usize = 800;

#[test]
fn a_reward_that_is_not_a_number_is_an_error_and_no_checkpoint_holds_it() {
    static TASK: Faulty = Faulty::new("no-number", 5 * ROLLOUT / 2, || f64::NAN);
    let scratch = Scratch::new("reward");
    let mut run = run_of(&scratch, &TASK);
    let error = loop {
        match run.advance() {
            Ok(event) => assert!(event.is_some()),
            Err(error) => break error,
        }
    };
    assert!(error.to_string().contains("NaN"), "{error}");
    let (folder, learnt) = (run.folder().path().to_owned(), run.stats().rollouts);
    assert!(matches!(run.save_checkpoint().unwrap_err(), RunError::FailedEarlier));
    assert_eq!(checkpoints(&folder).len(), learnt, "one after each rollout before");
    let log = std::fs::read_to_string(folder.join("log.txt")).unwrap();
    assert!(log.contains("NaN"), "{log}");
}

#[test]
fn a_panic_in_a_task_is_a_failure_of_its_environment_alone() {
    static TASK: Faulty = Faulty::new("panic", 3 * ROLLOUT / 2, || panic!("the task fell over"));
    let scratch = Scratch::new("panic");
    let mut run = run_of(&scratch, &TASK);
    while run.advance().unwrap().is_some() {}
    assert!(run.is_finished());
    assert_eq!(run.stats().environment_failures, 1);
    let log = std::fs::read_to_string(run.folder().path().join("log.txt")).unwrap();
    let cause = "the task fell over; its episode counts as one that ended there";
    assert_eq!(log.matches(cause).count(), 1, "{log}");
}

#[test]
fn a_failure_in_an_evaluation_is_logged_with_its_cause() {
    // four rollouts, and then the evaluation
    static TASK: Faulty =
        Faulty::new("late-panic", 9 * ROLLOUT / 2, || panic!("it fell over late"));
    let scratch = Scratch::new("late-panic");
    let mut run = run_of(&scratch, &TASK);
    let mut warnings = Vec::new();
    while let Some(event) = run.advance().unwrap() {
        if let RunEvent::Evaluation(_) = event {
            warnings.extend(event.warnings());
        }
    }
    assert_eq!(run.stats().environment_failures, 0, "none in training");
    assert!(warnings.len() == 1 && warnings[0].contains("it fell over late"), "{warnings:?}");
    let log = std::fs::read_to_string(run.folder().path().join("log.txt")).unwrap();
    assert_eq!(log.matches("it fell over late").count(), 1, "{log}");
}

/// The first update leaves parameters that are finite, but so large that the second overflows.
fn diverging() -> Experiment {
    let mut experiment = tiny(Method::Covers);
    let covers::LearnerSettings::Covers(settings) = &mut experiment.learner else {
        panic!("{:?}", experiment.learner);
    };
    settings.ppo.head_learning_rate = 1e6;
    settings.ppo.encoder_learning_rate = 1e6;
    // one step of the optimiser
    settings.ppo.minibatch = settings.rollout_steps;
    experiment
}

#[test]
fn a_gradient_that_overflows_is_an_error_and_no_checkpoint_holds_it() {
    let scratch = Scratch::new("gradient");
    let mut run = Run::start(diverging(), scratch.run("run")).unwrap();
    let error = loop {
        match run.advance() {
            Ok(event) => assert!(event.is_some(), "it must not end"),
            Err(error) => break error,
        }
    };
    let message = error.to_string();
    let named = ["NaN", "inf"].iter().any(|value| message.contains(value));
    assert!(named, "{message}");
    let (folder, learnt) = (run.folder().path().to_owned(), run.stats().rollouts);
    drop(run);
    assert!(learnt > 0, "it must not diverge at once");
    assert_eq!(checkpoints(&folder).len(), learnt);
    // a resumption refuses numbers that are not finite
    for rollouts in (1..=learnt).rev() {
        let resumed = Run::resume(&folder, Some(1)).unwrap();
        assert_eq!(resumed.stats().rollouts, rollouts, "{}", resumed.start_message());
        std::fs::remove_file(newest(&folder)).unwrap();
    }
}

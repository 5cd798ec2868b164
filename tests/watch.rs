//! What `covers watch` prints of runs, and what it refuses.

use std::fs;
use std::path::Path;

use covers::experiments::text::{ROLLOUT_LINE_HEADER, format_run_event};
use covers::presets::{Budget, Method};
use covers::watch::WatchOptions;
use covers::{CoversError, Run, RunEvent, RunFolder};
use envs::Embodiment;
use serde_json::Value;

use crate::common::packed;
use crate::common::scratch::Scratch;

/// What `covers watch` prints of a folder, as a program hears it.
fn watched(folder: &Path, json: bool) -> Result<String, CoversError> {
    let mut out = Vec::new();
    WatchOptions { run_folder: folder.to_owned(), json }.print_events(&mut out)?;
    Ok(String::from_utf8(out).unwrap())
}

fn refusal(folder: &Path) -> String {
    watched(folder, false).unwrap_err().to_string()
}

#[test]
fn lines_are_those_of_the_run_itself_and_end_with_it() {
    let scratch = Scratch::new("watch");
    let mut experiment = Budget::Smoke.preset_experiment(Method::Covers).with_threads(2);
    experiment = experiment.with_embodiment(Embodiment::FLOATING_HAND);
    experiment.schedule.groups.truncate(2);
    experiment.evaluation.visit_episodes_per_env = 1;
    let folder = RunFolder::create(&scratch.0, "covers-seed0").unwrap();
    let path = folder.path().to_owned();
    let mut run = Run::start(experiment, folder).unwrap();
    let (mut rollouts, mut evaluations) = (Vec::new(), 0);
    while let Some(event) = run.advance().unwrap() {
        match event {
            RunEvent::Rollout(_) => rollouts.push(format_run_event(&event)),
            RunEvent::Evaluation(_) => evaluations += 1,
        }
    }
    let summary = run.summary().unwrap().unwrap();
    let text = watched(&path, false).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.remove(0), ROLLOUT_LINE_HEADER);
    assert_eq!(lines.len(), rollouts.len() + evaluations + 1, "{text}");
    let others = |line: &str| line.contains("  evaluation  ") || line.starts_with("finished");
    let told = lines.iter().filter(|line| !others(line));
    assert_eq!(told.copied().collect::<Vec<_>>(), rollouts);
    assert!(lines[0].starts_with("        0  evaluation    success [goal-reach "));
    assert!(lines.last().unwrap().starts_with("finished: "));
    let events = events(&watched(&path, true).unwrap());
    assert_eq!(events.len(), lines.len());
    let figures = &events.last().unwrap()["summary"];
    assert_eq!(figures["decisions"], summary.decisions);
    let of = |kind: &str| events.iter().filter(|event| event["event"] == kind).count();
    assert_eq!(of("rollout"), rollouts.len());
    assert_eq!(of("evaluation"), evaluations);
}

/// Objects, one a line.
fn events(text: &str) -> Vec<Value> {
    let lines = text.lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn what_is_no_run_is_refused() {
    let scratch = Scratch::new("unwatched");
    let message = refusal(&scratch.0.join("nowhere"));
    assert!(message.contains("nowhere holds no run"), "{message}");
    assert!(refusal(&scratch.0).contains("holds no run"));
    let packed = scratch.pack(&packed::small(Method::Equi));
    let packed_message = refusal(&packed);
    assert!(packed_message.contains("without the history"), "{packed_message}");
    let text = "rollout,decisions,group,last_group,straddles,policy\n0,500,a,a,false,501\n";
    fs::write(packed.join("metrics.csv"), text).unwrap();
    assert!(refusal(&packed).contains("metrics.csv, rollout 0: `policy` is a policy that"));
}

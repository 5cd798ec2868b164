//! What `covers report` says of runs, and what it refuses.

use std::fs;
use std::path::Path;

use clap::Parser;
use covers::commands::Command;
use covers::presets::{Budget, Method};
use covers::{CoversError, Experiment, Run, RunFolder, Summary};

use crate::common::scratch::Scratch;

impl Scratch {
    /// Runs to the end in a folder of this name.
    fn run(&self, name: &str, experiment: Experiment) -> Summary {
        let folder = RunFolder::create(&self.0, name).unwrap();
        let mut run = Run::start(experiment, folder).unwrap();
        while run.advance().unwrap().is_some() {}
        run.summary().unwrap().unwrap()
    }

    /// Reports the runs of these names.
    fn report(&self, names: &[&str], more: &[&str]) -> Result<String, CoversError> {
        let folders = names.iter().map(|name| self.0.join(name));
        let folders: Vec<String> = folders.map(|path| path.display().to_string()).collect();
        let folders: Vec<&str> = folders.iter().map(String::as_str).collect();
        let mut out = Vec::new();
        Options::try_parse_from([&["covers", "report"], &folders[..], more].concat())
            .unwrap()
            .command
            .run(&mut out)?;
        Ok(String::from_utf8(out).unwrap())
    }

    fn refusal(&self, names: &[&str]) -> String {
        self.report(names, &[]).unwrap_err().to_string()
    }
}

/// The subcommands as the program has them.
#[derive(Debug, Parser)]
struct Options {
    #[command(subcommand)]
    command: Command,
}

/// A smoke run of two groups that is scored all along.
fn small(method: Method, seed: u64) -> Experiment {
    let mut experiment = Budget::Smoke.experiment(method).with_seed(seed);
    experiment.schedule.groups.truncate(2);
    experiment.evaluation.visit_rounds = 1;
    experiment.evaluation.looks = 1;
    experiment.with_threads(2)
}

/// The mean over a run's groups.
fn average(summary: &Summary, figure: fn(&covers::evaluation::GroupScore) -> f64) -> f64 {
    let groups = summary.groups.iter().map(figure);
    groups.sum::<f64>() / summary.groups.len() as f64
}

#[test]
fn a_report_says_what_the_runs_files_say() {
    let scratch = Scratch::new("says");
    let runs = ["covers-seed0", "covers-seed1", "cnn-seed0"];
    let methods = [(Method::Covers, 0), (Method::Covers, 1), (Method::Cnn, 0)];
    let summaries: Vec<Summary> = runs
        .iter()
        .zip(methods)
        .map(|(name, (method, seed))| scratch.run(name, small(method, seed)))
        .collect();
    let out = scratch.0.join("out");
    let text = scratch
        .report(&runs, &["--out", out.to_str().unwrap()])
        .unwrap();
    let rows = text.lines().map(|line| line.split(" | ").collect());
    let rows: Vec<Vec<&str>> = rows.collect();
    let row = |name: &str, cells: usize| {
        let mut rows = rows.iter();
        let found = rows.find(|row| row[0] == format!("| {name}") && row.len() == cells);
        found.unwrap()
    };
    let of_two = |figure: &dyn Fn(&Summary) -> f64| {
        f64::midpoint(figure(&summaries[0]), figure(&summaries[1]))
    };
    let success = of_two(&|summary| average(summary, |group| group.success));
    assert!(row("covers", 14)[3].starts_with(&format!("{success:.3} [")));
    let accuracy = of_two(&|summary| summary.assignment_accuracy.unwrap());
    assert_eq!(row("covers", 14)[8], format!("{accuracy:.3}"));
    let success = average(&summaries[2], |group| group.success);
    assert_eq!(row("cnn", 14)[3], format!("{success:.3}"));
    assert!(
        row("cnn", 14)[8].starts_with("- ("),
        "one policy has no accuracy"
    );
    assert_eq!(row("cnn", 5)[3], "too few seeds");
    let reward = average(&summaries[2], |group| group.reward);
    assert_eq!(row("cnn-seed0", 7)[2], format!("{reward:.1}"));
    assert_eq!(
        row("covers-seed1", 7)[4],
        summaries[1].decisions.to_string()
    );
    assert!(text.contains("covers in the paper (1)") && text.contains("one to one"));
    for method in ["covers", "cnn"] {
        let dormant: f64 = row(method, 14)[12].parse().unwrap();
        assert!((0.0..1.0).contains(&dormant), "{dormant}");
    }
    let asked = |name: &str| {
        let mut rows = rows.iter();
        let found =
            rows.find(|row| row[0] == format!("| {name}") && row[1] == "1" && row.len() == 6);
        found.unwrap()[4]
    };
    assert!((0.0..=1.0).contains(&asked("covers").parse::<f64>().unwrap()));
    assert!(
        asked("cnn").starts_with("- ("),
        "one policy recognises nothing"
    );
    let files = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    assert_eq!(files("report.md").trim_end(), text.trim_end());
    assert!(files("results.csv").contains("\"covers\"") && files("seeds.tex").contains("toprule"));
    for drawing in ["covers-seed0.svg", "seed0.svg"] {
        assert!(files(drawing).contains("goal-reach"), "{drawing}");
    }
}

#[test]
fn runs_that_are_not_at_their_end_and_files_that_cannot_be_are_refused() {
    let scratch = Scratch::new("files");
    scratch.run("cnn-seed0", small(Method::Cnn, 0));
    let file = |name: &str| scratch.0.join("cnn-seed0").join(name);
    let without = |name: &str| {
        let bytes = fs::read(file(name)).unwrap();
        fs::remove_file(file(name)).unwrap();
        let refusal = scratch.refusal(&["cnn-seed0"]);
        fs::write(file(name), bytes).unwrap();
        refusal
    };
    assert!(without("summary.json").contains("not finished"));
    assert!(without("evaluation.csv").contains("evaluation.csv"));
    let scores = fs::read_to_string(file("evaluation.csv")).unwrap();
    let last = scores.lines().last().unwrap();
    // the columns of rollouts and of success
    for (cell, wrong, problem) in [(0, "1", "do not agree"), (7, "NaN", "cannot be")] {
        let mut cells: Vec<&str> = last.split(',').collect();
        cells[cell] = wrong;
        let changed = scores.replace(last, &cells.join(","));
        fs::write(file("evaluation.csv"), changed).unwrap();
        let refusal = scratch.refusal(&["cnn-seed0"]);
        assert!(refusal.contains(problem), "{refusal}");
    }
}

#[test]
fn the_papers_row_follows_the_settings_and_not_the_name() {
    let scratch = Scratch::new("names");
    let paper = |text: &str| {
        let rows = text.lines().filter(|line| line.contains("in the paper ("));
        rows.map(|row| row.split(" in ").next().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    scratch.run("covers-seed0", small(Method::Equi, 0));
    let text = scratch.report(&["covers-seed0"], &[]).unwrap();
    assert_eq!(paper(&text), ["| equi"]);
    let remark = "the settings are those of the preset `equi`, not of `covers`";
    assert!(
        text.contains("| covers (1) |") && text.contains(remark),
        "{text}"
    );
    let mut own = small(Method::Equi, 0);
    own.envs.camera.size = 32;
    scratch.run("equi-seed0", own);
    let text = scratch.report(&["equi-seed0"], &[]).unwrap();
    assert!(paper(&text).is_empty(), "{text}");
    assert!(text.contains("`envs.camera.size` 48 and 32"), "{text}");
}

#[test]
fn runs_that_do_not_compare_are_refused() {
    let scratch = Scratch::new("mixed");
    scratch.run("equi-seed0", small(Method::Equi, 0));
    scratch.run("equi-seed1", small(Method::Cnn, 1));
    let mut other = small(Method::Cnn, 0);
    other.schedule.cycles = 2;
    scratch.run("cnn-seed0", other);
    let refusal = scratch.refusal(&["equi-seed0", "equi-seed1"]);
    assert!(
        refusal.contains("learner.covers.network.group"),
        "{refusal}"
    );
    let refusal = scratch.refusal(&["equi-seed0", "cnn-seed0"]);
    assert!(refusal.contains("schedule.cycles"), "{refusal}");
    fs::create_dir(scratch.0.join("copy")).unwrap();
    let copied = Path::new("copy").join("equi-seed0");
    fs::rename(scratch.0.join("equi-seed1"), scratch.0.join("moved")).unwrap();
    scratch.run("copy/equi-seed0", small(Method::Equi, 0));
    let refusal = scratch.refusal(&["equi-seed0", copied.to_str().unwrap()]);
    assert!(refusal.contains("two runs have seed 0"), "{refusal}");
}

//! The main job: learn from a stream of table-top tasks that nobody labels.
//!
//! `cargo run --release --example continual_stream -- --budget short`

use std::io::{IsTerminal, stderr};
use std::process::ExitCode;

use clap::Parser;
use covers::cli::{StreamOptions, run_name};
use covers::presets::Method;
use covers::tables::{rollout_line, summary_table};
use covers::{CoversError, Run, RunFolder};
use envs::TaskRegistry;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

fn main() -> ExitCode {
    let options = StreamOptions::parse();
    match learn(&options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn learn(options: &StreamOptions) -> Result<(), CoversError> {
    let experiment = options
        .changes
        .apply(options.budget.experiment(Method::Covers));
    experiment.check(&TaskRegistry::standard())?;
    let name = run_name(options.budget.name(), &experiment);
    let folder = RunFolder::create(&options.output.runs, &name)?;
    let bar = progress_bar(experiment.schedule.total_rollouts());
    let mut run = Run::start(experiment, folder)?;
    while let Some(progress) = run.advance()? {
        bar.suspend(|| println!("{}", rollout_line(&progress)));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let summary = run.summary()?;
    println!("\n{}", summary_table(&summary));
    println!("files: {}", run.folder().path().display());
    if options.output.json {
        println!("{}", serde_json::json!(summary));
    }
    Ok(())
}

/// A bar on the terminal; nothing where the output is a file.
fn progress_bar(rollouts: usize) -> ProgressBar {
    let target = if stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    };
    let template = "{wide_bar} rollout {pos}/{len}, {eta} left";
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(Some(rollouts as u64), target).with_style(style)
}

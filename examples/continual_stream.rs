//! The main job: learn from a stream of table-top tasks that nobody labels.
//!
//! `cargo run --release --example continual_stream -- --budget short`

use std::io::{IsTerminal, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers::cli::{StreamOptions, run_name};
use covers::commands::{Outcome, conclude};
use covers::presets::Method;
use covers::tables::rollout_line;
use covers::{CoversError, Event, Run, Stop};
use envs::TaskRegistry;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

fn main() -> ExitCode {
    let options = StreamOptions::parse();
    match learn(&options) {
        Ok(outcome) => ExitCode::from(outcome.exit_code()),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn learn(options: &StreamOptions) -> Result<Outcome, CoversError> {
    let experiment = options.budget.experiment(Method::Covers);
    let experiment = options.run.changes.apply(experiment)?;
    experiment.check(&TaskRegistry::standard())?;
    let name = run_name(options.budget.name(), &experiment);
    let folder = options.run.output.run_folder(&name)?;
    let bar = progress_bar(experiment.schedule.total_decisions());
    let mut run = Run::start(experiment, folder)?;
    run.stop_at(Stop::on_signals()?);
    while let Some(event) = run.advance()? {
        if let Event::Rollout(progress) = event {
            bar.suspend(|| println!("{}", rollout_line(&progress)));
            if let Some(warning) = progress.warning {
                bar.suspend(|| eprintln!("warning: {warning}"));
            }
            bar.set_position(progress.decisions as u64);
        }
    }
    bar.finish_and_clear();
    conclude(&mut run, options.run.output.json, &mut stdout())
}

/// A bar on the terminal; nothing where the output is a file.
fn progress_bar(decisions: usize) -> ProgressBar {
    let target = if stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    };
    let template = "{wide_bar} decision {pos} of {len}, {eta} left";
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(Some(decisions as u64), target).with_style(style)
}

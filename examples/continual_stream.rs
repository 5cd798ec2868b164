//! Trains COVERS on an unlabelled stream of table-top tasks, with a progress bar.
//!
//! `cargo run --release --example continual_stream -- --budget short`

use std::io::{IsTerminal, Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers::cli::{StreamOptions, run_name};
use covers::commands::{CommandOutcome, print_summary_or_save};
use covers::experiments::text::rollout_line;
use covers::presets::Method;
use covers::{CoversError, Event, Run, StopSignal};
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

fn learn(options: &StreamOptions) -> Result<CommandOutcome, CoversError> {
    let experiment = options.budget.experiment(Method::Covers);
    let experiment = options.run_options.settings.apply(experiment)?;
    experiment.check(&TaskRegistry::all())?;
    let name = run_name(options.budget.name(), &experiment);
    let folder = options.run_options.run_folder.create_run_folder(&name)?;
    let bar = progress_bar(experiment.schedule.total_decisions());
    let mut run = Run::start(experiment, folder)?;
    let stop = StopSignal::from_os_signals()?;
    run.set_stop_signal(stop.clone());
    while let Some(event) = run.advance()? {
        if let Event::Rollout(progress) = event {
            let printed = bar.suspend(|| writeln!(stdout(), "{}", rollout_line(&progress)));
            // a closed terminal or pipe stops the run like Ctrl-C: with a checkpoint
            if printed.is_err() {
                stop.request();
            }
            if let Some(warning) = progress.warning {
                let _ = bar.suspend(|| writeln!(stderr(), "warning: {warning}"));
            }
            bar.set_position(progress.decisions as u64);
        }
    }
    bar.finish_and_clear();
    print_summary_or_save(&mut run, options.run_options.run_folder.json, &mut stdout())
}

/// Returns a progress bar that is hidden if standard error is no terminal.
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

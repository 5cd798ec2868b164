//! Trains COVERS on an unlabelled stream of table-top tasks.
//!
//! `cargo run --release --example continual_stream -- --budget short`

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers::cli::{ContinualStreamExampleOptions, run_name};
use covers::commands::{CommandOutcome, summarise_or_checkpoint};
use covers::experiments::text::{ROLLOUT_LINE_HEADER, format_rollout_line};
use covers::presets::Method;
use covers::{CoversError, Run, RunEvent, StopSignal};
use envs::TaskRegistry;

fn main() -> ExitCode {
    let options = ContinualStreamExampleOptions::parse();
    match learn(&options) {
        Ok(outcome) => ExitCode::from(outcome.exit_code()),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn learn(options: &ContinualStreamExampleOptions) -> Result<CommandOutcome, CoversError> {
    let settings = &options.run_options.settings;
    let experiment = settings.preset_experiment(options.budget, Method::default())?;
    experiment.check(&TaskRegistry::with_all())?;
    let name =
        run_name(&format!("{}-{}", Method::default().name(), options.budget.name()), &experiment);
    let folder = options.run_options.run_folder.create_run_folder(&name)?;
    let mut run = Run::start(experiment, folder)?;
    let stop = StopSignal::from_os_signals()?;
    run.set_stop_signal(stop.clone());
    // a closed terminal or pipe stops the run like Ctrl-C: with a checkpoint
    let say = |line: &str| {
        if writeln!(stdout(), "{line}").is_err() {
            stop.request();
        }
    };
    say(ROLLOUT_LINE_HEADER);
    while let Some(event) = run.advance()? {
        if let RunEvent::Rollout(progress) = &event {
            say(&format_rollout_line(progress));
        }
        for warning in event.warnings() {
            let _ = writeln!(stderr(), "warning: {warning}");
        }
    }
    summarise_or_checkpoint(&mut run, options.run_options.run_folder.json, &mut stdout())
}

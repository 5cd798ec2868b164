//! The `covers` command.
//!
//! Exit codes: 0 where all was done, every check held and everything works, 1 for an error, a check
//! that failed or a machine that lacks something, 2 for wrong options, 3 where a signal stopped a
//! run that can be resumed.

use std::io::stdout;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use covers::check::Check;
use covers::commands::{Command, Outcome};
use covers::deploy::{CalibrateOptions, DeployOptions};
use covers::doctor::DoctorOptions;
use covers::export::ExportOptions;
use covers::preset_list::PresetsOptions;
use covers::render::RenderOptions;
use covers::watch::WatchOptions;

/// Continual vision-based reinforcement learning with group symmetries.
#[derive(Debug, Parser)]
#[command(version)]
struct Options {
    #[command(subcommand)]
    command: Subcommands,
}

#[derive(Debug, Subcommand)]
enum Subcommands {
    #[command(flatten)]
    Learner(Command),
    /// Lets the policies of a run act on a robot that a camera watches.
    Deploy(DeployOptions),
    /// Finds where a robot's camera is, by a ball that the arm carries.
    Calibrate(CalibrateOptions),
    /// Shows a run while it goes on: curves, groups and policies, distances.
    Watch(WatchOptions),
    /// Shows policies at work, as a GIF or an mp4.
    Render(RenderOptions),
    /// Writes a policy for other programs: ONNX, and safetensors for PyTorch.
    Export(ExportOptions),
    /// Checks the environments, and a robot's mask; fails where a figure misses its bound.
    #[command(subcommand)]
    Check(Check),
    /// Says what this machine has, how fast it is, and how to cure what is missing.
    Doctor(DoctorOptions),
    /// Lists methods and budgets, or prints all that a preset sets.
    Presets(PresetsOptions),
}

fn main() -> ExitCode {
    let result = match Options::parse().command {
        Subcommands::Learner(command) => command.run(&mut stdout()).map(Outcome::exit_code),
        Subcommands::Deploy(deploy) => deploy.run(&mut stdout()).map(|()| 0),
        Subcommands::Calibrate(calibrate) => calibrate.run(&mut stdout()).map(|()| 0),
        Subcommands::Watch(watch) => watch.run(&mut stdout()),
        Subcommands::Render(render) => render.run(&mut stdout()).map(|()| 0),
        Subcommands::Export(export) => export.run(&mut stdout()).map(|()| 0),
        Subcommands::Check(check) => check.run(&mut stdout()).map(|held| u8::from(!held)),
        Subcommands::Doctor(doctor) => doctor.run(&mut stdout()).map(|works| u8::from(!works)),
        Subcommands::Presets(presets) => presets.run(&mut stdout()).map(|()| 0),
    };
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

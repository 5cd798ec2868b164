//! The `covers` command.

use std::io::stdout;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use covers::check::Check;
use covers::commands::Command;

/// Continual vision-based reinforcement learning with group symmetries.
#[derive(Debug, Parser)]
#[command(version)]
struct Options {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    #[command(flatten)]
    Learner(Command),
    /// Checks the environments; fails where a figure misses its bound.
    #[command(subcommand)]
    Check(Check),
}

fn main() -> ExitCode {
    let result = match Options::parse().task {
        Task::Learner(command) => command.run(&mut stdout()).map(|()| true),
        Task::Check(check) => check.run(&mut stdout()),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

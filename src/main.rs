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
    command: Subcommands,
}

#[derive(Debug, Subcommand)]
enum Subcommands {
    #[command(flatten)]
    Learner(Command),
    /// Checks the environments; fails where a figure misses its bound.
    #[command(subcommand)]
    Check(Check),
}

fn main() -> ExitCode {
    let result = match Options::parse().command {
        Subcommands::Learner(command) => command.run(&mut stdout()).map(|()| true),
        Subcommands::Check(check) => check.run(&mut stdout()),
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

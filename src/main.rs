//! The `covers` command.
//!
//! Exit codes: 0 where all was done and every check held, 1 for an error or a check that failed, 2
//! for wrong options, 3 where a signal stopped a run that can be resumed.

use std::io::stdout;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use covers::check::Check;
use covers::commands::{Command, Outcome};

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
        Subcommands::Learner(command) => command.run(&mut stdout()).map(Outcome::exit_code),
        Subcommands::Check(check) => check.run(&mut stdout()).map(|held| u8::from(!held)),
    };
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

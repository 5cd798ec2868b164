//! The `covers` command.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use covers::check::Check;

/// Continual vision-based reinforcement learning with group symmetries.
#[derive(Debug, Parser)]
#[command(version)]
struct Options {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Checks the environments; fails where a figure misses its bound.
    #[command(subcommand)]
    Check(Check),
}

fn main() -> ExitCode {
    let Command::Check(check) = Options::parse().command;
    match check.run(&mut std::io::stdout()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

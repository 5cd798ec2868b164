//! The `covers` command; `covers --help` says what its exit codes mean.

use std::io::stdout;
use std::process::ExitCode;

use clap::Parser;
use covers::program::Program;

fn main() -> ExitCode {
    match Program::parse().run(&mut stdout()) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

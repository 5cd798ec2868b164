//! The command `covers-rerun`; `covers-rerun --help` lists its options.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers_rerun::Options;

fn main() -> ExitCode {
    match Options::parse().run(&mut stdout()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // a terminal that is gone reads nothing, and is no reason to panic
            let _ = writeln!(stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

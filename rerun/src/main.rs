//! Command `covers-rerun`; `covers-rerun --help` lists its options.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers_rerun::RerunOptions;

fn main() -> ExitCode {
    match RerunOptions::parse().run(&mut stdout()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // `eprintln!` would panic if the terminal is gone
            let _ = writeln!(stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

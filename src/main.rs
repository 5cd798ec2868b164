//! The `covers` command; `covers --help` says what its exit codes mean.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers::program::{Program, error_line};

fn main() -> ExitCode {
    match Program::parse().run(&mut stdout()) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            // a terminal that is gone hears nothing, and is no reason to panic
            let _ = writeln!(stderr(), "{}", error_line(&error));
            ExitCode::FAILURE
        }
    }
}

//! The `covers` command; `covers --help` lists its exit codes.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use covers::program::{Program, format_error};

fn main() -> ExitCode {
    match Program::parse().run(&mut stdout()) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            // `eprintln!` would panic if the terminal was closed
            let _ = writeln!(stderr(), "{}", format_error(&error));
            ExitCode::FAILURE
        }
    }
}

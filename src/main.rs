//! The `covers` command; `covers --help` lists its exit codes.

use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use console::style;
use covers::program::CoversCli;
use experiments::printable::printable_message;

/// Largest number of bytes of a message about wrong options that is printed as it is.
const LONGEST_USAGE_ERROR: usize = 2000;

fn main() -> ExitCode {
    let program = match CoversCli::try_parse() {
        // a long value would fill the terminal, but for help and version all is asked for
        Err(error) if error.use_stderr() && error.to_string().len() > LONGEST_USAGE_ERROR => {
            let _ = writeln!(stderr(), "{}", printable_message(&error));
            return ExitCode::from(2);
        }
        parsed => parsed.unwrap_or_else(|error| error.exit()),
    };
    match program.run(&mut stdout()) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            // control characters of file names are escaped; `eprintln!` would panic if the terminal
            // was closed
            let label = style("error:").red().bold().for_stderr();
            let _ = writeln!(stderr(), "{label} {}", printable_message(&error));
            ExitCode::FAILURE
        }
    }
}

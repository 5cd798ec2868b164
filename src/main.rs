//! The `covers` command; `covers --help` lists its exit codes.

use std::error::Error;
use std::io::{self, ErrorKind, Stdout, Write, stderr, stdout};
use std::iter;
use std::process::ExitCode;

use clap::Parser;
use console::style;
use covers::program::CoversCli;
use experiments::printable::printable_message;

/// Largest number of bytes of a message about wrong options that is printed as it is.
const LONGEST_USAGE_ERROR: usize = 2000;
/// Exit code of a program that SIGPIPE ends: 128 plus the signal's number. Rust ignores the signal,
/// so that a training run can still write a checkpoint.
const CLOSED_OUTPUT: u8 = 128 + 13;

fn main() -> ExitCode {
    let program = match CoversCli::try_parse() {
        // a long value would fill the terminal, but help and version are wanted whole
        Err(error) if is_usage_error(&error) && error.to_string().len() > LONGEST_USAGE_ERROR => {
            let _ = writeln!(stderr(), "{}", printable_message(&error));
            return ExitCode::from(2);
        }
        parsed => parsed.unwrap_or_else(|error| error.exit()),
    };
    let mut out = Output { stdout: stdout(), is_closed: false };
    match program.run(&mut out) {
        Ok(code) => ExitCode::from(code),
        // as after `covers presets | head -1`: the reader has all that it wants
        Err(error) if out.is_closed && is_broken_pipe(&error) => ExitCode::from(CLOSED_OUTPUT),
        Err(error) => {
            // control characters of file names are escaped; `eprintln!` would panic if the terminal
            // was closed
            let label = style("error:").red().bold().for_stderr();
            let _ = writeln!(stderr(), "{label} {}", printable_message(&error));
            ExitCode::FAILURE
        }
    }
}

/// Returns `true` for wrong options, which are no request for help.
fn is_usage_error(error: &clap::Error) -> bool {
    use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand as Help;
    error.use_stderr() && error.kind() != Help
}

/// Returns `true` if a closed output is the error or its cause. Programs that this one starts, such
/// as `ffmpeg`, can have closed theirs, too.
fn is_broken_pipe(error: &(dyn Error + 'static)) -> bool {
    let causes = iter::successors(Some(error), |&error| error.source());
    causes
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == ErrorKind::BrokenPipe)
}

/// Standard output, which notes that its reader has closed it.
struct Output {
    stdout: Stdout,
    is_closed: bool,
}

impl Output {
    fn note<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        let is_broken = |error: &io::Error| error.kind() == ErrorKind::BrokenPipe;
        self.is_closed |= result.as_ref().is_err_and(is_broken);
        result
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.stdout.write(bytes);
        self.note(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        let flushed = self.stdout.flush();
        self.note(flushed)
    }
}

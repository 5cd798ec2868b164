//! Options and output that several commands share.

use std::io::Write;
use std::path::Path;

use clap::Args;
use clap::builder::RangedI64ValueParser;
use envs::MAX_THREADS;
pub use indicatif::ProgressBar;
use indicatif::{ProgressDrawTarget, ProgressFinish, ProgressStyle};

use crate::error::RunError;
use crate::printable::escape_unprintable_lines;

/// Returns the command line's parser of numbers of threads, from 1 to [`MAX_THREADS`].
pub fn thread_count_parser() -> RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(1..=MAX_THREADS as i64)
}

/// Command-line option for the number of worker threads.
#[derive(Clone, Copy, Debug, Args)]
pub struct ThreadCountOption {
    /// Number of worker threads (default: one per CPU); results do not depend on it.
    #[arg(long, value_parser = thread_count_parser())]
    pub threads: Option<u16>,
}

impl ThreadCountOption {
    /// Returns the number of worker threads: the requested one, or else that of available CPUs.
    pub fn count(self) -> usize {
        let available = || std::thread::available_parallelism().map_or(1, usize::from);
        self.threads.map_or_else(available, usize::from)
    }
}

/// Returns a progress bar of `length` steps on standard error, with the time left. It is hidden if
/// standard error is no terminal, and disappears at the end.
pub fn progress_bar(length: usize) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length as u64), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{percent:>3} % {wide_bar} {eta} left");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        .with_finish(ProgressFinish::AndClear)
}

/// Prints a line with control characters escaped, since names of files and cells of tables may
/// hold terminal commands.
///
/// # Errors
/// [`RunError::Write`].
pub fn print_escaped(out: &mut impl Write, line: &str) -> Result<(), RunError> {
    print_styled(out, line, |escaped| escaped)
}

/// Prints a line as [`print_escaped`] does, in the style that `apply_style` adds to the escaped
/// line.
///
/// # Errors
/// [`RunError::Write`].
pub fn print_styled(
    out: &mut impl Write,
    line: &str,
    apply_style: impl FnOnce(String) -> String,
) -> Result<(), RunError> {
    let line = apply_style(escape_unprintable_lines(line));
    let written = writeln!(out, "{line}").and_then(|()| out.flush());
    written.map_err(RunError::write_error_mapper(Path::new("standard output")))
}

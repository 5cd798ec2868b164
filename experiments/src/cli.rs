//! Options and output that several commands share.

use std::io::Write;
use std::path::Path;

use clap::Args;
use clap::builder::RangedI64ValueParser;
use envs::MAX_THREADS;

use crate::error::RunError;
use crate::printable::printable_lines;

/// What a number of threads may be.
pub fn thread_count() -> RangedI64ValueParser<u16> {
    clap::value_parser!(u16).range(1..=MAX_THREADS as i64)
}

/// How many threads work.
#[derive(Clone, Copy, Debug, Args)]
pub struct Threads {
    /// Worker threads (default: one a processor); results do not depend on them.
    #[arg(long, value_parser = thread_count())]
    pub threads: Option<u16>,
}

impl Threads {
    /// The number asked for, or one a processor.
    pub fn count(self) -> usize {
        let available = || std::thread::available_parallelism().map_or(1, usize::from);
        self.threads.map_or_else(available, usize::from)
    }
}

/// Prints a line, in which no name of a file or of a table's cell steers the terminal.
///
/// # Errors
/// [`RunError::Write`].
pub fn say(out: &mut impl Write, line: &str) -> Result<(), RunError> {
    let line = printable_lines(line);
    writeln!(out, "{line}").map_err(|error| RunError::write(Path::new("standard output"), error))
}

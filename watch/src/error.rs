//! Errors of this crate.

use std::path::PathBuf;

use experiments::RunError;

/// Error of watching the progress of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WatchError {
    /// Failure to read the run's folder or to use the terminal.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Folder that holds policies but none of the tables of a run.
    #[error(
        "{} has no tables to watch: `covers pack` keeps only policies. Watch the run's own folder",
        folder.display()
    )]
    NoTables {
        /// Folder without tables.
        folder: PathBuf,
    },
}

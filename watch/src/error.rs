//! Errors of this crate.

use std::path::PathBuf;

use experiments::RunError;

/// Error of following a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WatchError {
    /// A run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A folder that has policies and no tables.
    #[error(
        "{} has no tables to watch: `covers pack` leaves policies alone. Watch the run's own folder",
        folder.display()
    )]
    NoTables {
        /// The folder.
        folder: PathBuf,
    },
}

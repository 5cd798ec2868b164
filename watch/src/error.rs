//! Errors of this crate.

use experiments::RunError;

/// Error of watching the progress of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WatchError {
    /// Failure to read the run's folder or to use the terminal.
    #[error(transparent)]
    Run(#[from] RunError),
}

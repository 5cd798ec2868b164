//! Errors of reports.

use std::path::PathBuf;

use experiments::RunError;

/// Error of making a report on runs.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// Error of a run's files or settings.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Runs that cannot be compared in one table.
    #[error("run {run} cannot be reported with the runs before it ({differences}): {remedy}")]
    IncomparableRuns {
        /// Name of the run that differs from the others.
        run: String,
        /// Differences of that run from the runs before it.
        differences: String,
        /// Description of what to do about the differences.
        remedy: &'static str,
    },
    /// Two runs of the same name, whose TensorBoard events would go to one folder.
    #[error(
        "{} and {} have one name, and their events would go to one folder: give one of the runs \
         another name, or call the command for each with a folder of its own",
        first.display(), second.display()
    )]
    DuplicateRunName {
        /// Folder of the first run of this name.
        first: PathBuf,
        /// Folder of another run of this name.
        second: PathBuf,
    },
}

impl From<learner::LearnerError> for ReportError {
    fn from(error: learner::LearnerError) -> Self {
        Self::Run(error.into())
    }
}

//! Errors of the program.

use deploy::DeployError;
use experiments::RunError;
use learner::LearnerError;
use render::RenderError;
use report::ReportError;
use watch::WatchError;

/// Error of a command.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoversError {
    /// A run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A report.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A film.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Following a run.
    #[error(transparent)]
    Watch(#[from] WatchError),
    /// A trial on a robot, or a calibration.
    #[error(transparent)]
    Deploy(#[from] DeployError),
    /// Jobs of a sweep that failed.
    #[error("these jobs failed, each for the reason told above: {}", failed.join(", "))]
    Jobs {
        /// Their names.
        failed: Vec<String>,
    },
    /// A screen where there is none.
    #[error(
        "`--tui` draws on a terminal, and standard output is none: leave it out, or follow the run \
         with `covers watch`"
    )]
    NoTerminal,
}

impl From<LearnerError> for CoversError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}

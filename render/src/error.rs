//! Errors of this crate.

use std::path::PathBuf;

use experiments::RunError;
use learner::LearnerError;

/// Error of a film.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A file whose name does not say what can be written.
    #[error("{} cannot be written: expected a name with the ending {expected}", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
        /// The endings that there are.
        expected: &'static str,
    },
    /// A film that would need a program which is not there.
    #[error(
        "{} takes `ffmpeg`, which is not on the path: install it, or choose a name that ends in .gif",
        path.display()
    )]
    NoFfmpeg {
        /// The file.
        path: PathBuf,
    },
}

impl From<LearnerError> for RenderError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}

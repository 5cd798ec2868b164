//! Errors of this crate.

use std::path::PathBuf;

use experiments::RunError;
use learner::LearnerError;

/// Error of filming a run's policies.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// Error of the run whose policies are filmed.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Requested film whose file name has no supported extension.
    #[error("{} cannot be written: expected a name with the ending {expected}", path.display())]
    UnsupportedExtension {
        /// Requested path of the film.
        path: PathBuf,
        /// List of the supported file extensions.
        expected: &'static str,
    },
    /// Mirrored pictures of the view from a corner, which are those of no other variant.
    #[error(
        "pictures of the view `perspective` cannot be mirrored back, since the mirror image of a view \
         from one corner is a view from another. Leave out --twins, or choose the views seen, raw and mask"
    )]
    MirroredPerspective,
    /// Film in a format that needs `ffmpeg`, which was not found.
    #[error(
        "{} needs `ffmpeg`, which is not on the path: install it, or choose a name that ends in .gif",
        path.display()
    )]
    NoFfmpeg {
        /// Requested path of the film.
        path: PathBuf,
    },
}

impl From<LearnerError> for RenderError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}

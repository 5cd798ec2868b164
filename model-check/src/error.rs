//! Errors of checks.

use std::path::PathBuf;

use mujoco::ModelError;
use robots::DescriptionError;

use crate::snapshot::Kind;

/// Error of checking a model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckError {
    /// File that cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of reading.
        source: std::io::Error,
    },
    /// File that is not well-formed XML, or JSON of corrections with other fields.
    #[error("{} cannot be used: {message}", path.display())]
    InvalidFile {
        /// Path of the file.
        path: PathBuf,
        /// Error with its place in the file.
        message: String,
    },
    /// Model that MuJoCo rejected.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// URDF that was rejected.
    #[error(transparent)]
    Robot(#[from] DescriptionError),
    /// Correction of an object that the model does not have.
    #[error("the model has no {kind} `{name}`; it has: {}", known.join(", "))]
    UnknownObject {
        /// Kind of the object.
        kind: Kind,
        /// Name in the corrections.
        name: String,
        /// Names that reports use for the objects of this kind.
        known: Vec<String>,
    },
    /// Corrected plane without a direction.
    #[error("the plane's normal is {normal:?}; expected a vector of length 1")]
    InvalidNormal {
        /// Normal in the corrections.
        normal: [f64; 3],
    },
}

//! Errors of checks.

use std::path::PathBuf;

use mujoco::ModelError;
use robots::DescriptionError;

use crate::mirror::MirrorPlane;
use crate::snapshot::ModelObjectKind;

/// Error of checking a model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelSymmetryError {
    /// File that cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Path of the file that cannot be read.
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
    /// Picture of the model that cannot be drawn.
    #[error("cannot draw the model: {0}")]
    Picture(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// Correction of an object that the model does not have.
    #[error("the model has no {kind} `{name}`; it has: {}", known.join(", "))]
    UnknownObject {
        /// Kind of the object.
        kind: ModelObjectKind,
        /// Name in the corrections.
        name: String,
        /// Names that reports use for the objects of this kind.
        known: Vec<String>,
    },
    /// Ignored object that the model does not have.
    #[error(
        "the corrections ignore `{name}`, which the model does not have; expected a kind and a \
         name, such as `body left_leg`"
    )]
    UnknownIgnored {
        /// Text in the corrections.
        name: String,
    },
    /// Corrected pair of objects that cannot be counterparts.
    #[error("the corrections pair the {kind}s `{}` and `{}`: {reason}", pair[0], pair[1])]
    UnusablePair {
        /// Kind of the objects.
        kind: ModelObjectKind,
        /// Names of the objects.
        pair: [String; 2],
        /// Reason for which they cannot be counterparts.
        reason: &'static str,
    },
    /// Corrected plane without a direction or a place.
    #[error("the plane is {plane:?}; expected a normal of length 1 and a finite offset")]
    InvalidPlane {
        /// Plane in the corrections.
        plane: MirrorPlane,
    },
    /// Tolerance that would hide every difference, or that is negative.
    #[error("the tolerance is {tolerance}, expected a number from 0 to 1")]
    InvalidTolerance {
        /// Tolerance of the settings.
        tolerance: f64,
    },
}

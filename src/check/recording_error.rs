//! What can be wrong with a recording.

/// What is wrong with a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// It cannot be read.
    #[error("it cannot be read: {source}")]
    Open {
        /// The reason.
        source: std::io::Error,
    },
    /// A folder without recordings.
    #[error("no recording in it: expected files named ENGINE_TASK_POLICY.npz")]
    NoFiles,
    /// It is no zip archive.
    #[error("it is not an npz archive: {source}")]
    NotAnArchive {
        /// The reason.
        source: zip::result::ZipError,
    },
    /// Its name holds no task.
    #[error(
        "its name says no task: expected ENGINE_TASK_POLICY.npz, \
         where TASK is one of reach, button-press, drawer-close, plate-slide"
    )]
    UnknownTask,
    /// It lacks an array.
    #[error("the array `{name}` is missing among {known:?}")]
    Missing {
        /// The array.
        name: &'static str,
        /// What the archive holds.
        known: Vec<String>,
    },
    /// An array that is not what it says.
    #[error("the array `{name}` is damaged: {reason}")]
    Damaged {
        /// The array.
        name: &'static str,
        /// What is wrong.
        reason: &'static str,
    },
    /// An array of something else.
    #[error(
        "the array `{name}` holds values of kind `{got}`, \
         expected `<f8` (64-bit numbers) or `|b1` (truth values)"
    )]
    Kind {
        /// The array.
        name: &'static str,
        /// NumPy's word for what it holds.
        got: String,
    },
    /// An array of another shape.
    #[error("the array `{name}` has the shape {got:?}, expected {expected:?} (0 stands for any)")]
    Shape {
        /// The array.
        name: &'static str,
        /// Its shape.
        got: Vec<usize>,
        /// The shape that the other arrays or the task ask for.
        expected: Vec<usize>,
    },
    /// An array with something that is not a number.
    #[error("the array `{name}` is not finite at {index}")]
    NotFinite {
        /// The array.
        name: &'static str,
        /// Index into its values.
        index: usize,
    },
}

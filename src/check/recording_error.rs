//! Errors of recordings.

/// Error of reading a recording of Meta-World.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// File that cannot be read.
    #[error("it cannot be read: {source}")]
    Open {
        /// Underlying error.
        source: std::io::Error,
    },
    /// Folder without recordings.
    #[error("no recording in it: expected files named ENGINE_TASK_POLICY.npz")]
    NoFiles,
    /// File that is no zip archive.
    #[error("it is not an npz archive: {source}")]
    NotAnArchive {
        /// Underlying error.
        source: zip::result::ZipError,
    },
    /// File whose name does not contain a task.
    #[error(
        "its name says no task: expected ENGINE_TASK_POLICY.npz, \
         where TASK is one of Meta-World's: {}", known.join(", ")
    )]
    UnknownTask {
        /// Meta-World's names of the tasks.
        known: Vec<&'static str>,
    },
    /// Missing array.
    #[error("the array `{name}` is missing among those of the archive: {}", known.join(", "))]
    Missing {
        /// Name of the missing array.
        name: &'static str,
        /// Names of the files in the archive.
        known: Vec<String>,
    },
    /// Array in an invalid file.
    #[error("the array `{name}` is damaged: {reason}")]
    Damaged {
        /// Name of the array.
        name: &'static str,
        /// Description of the problem.
        reason: &'static str,
    },
    /// Array of an unsupported type.
    #[error(
        "the array `{name}` holds values of kind `{got}`, \
         expected `<f8` (64-bit numbers) or `|b1` (truth values)"
    )]
    Kind {
        /// Name of the array.
        name: &'static str,
        /// NumPy's name of the type.
        got: String,
    },
    /// Array of a wrong shape.
    #[error("the array `{name}` has the shape {got:?}, expected {expected:?} (0 stands for any)")]
    Shape {
        /// Name of the array.
        name: &'static str,
        /// Shape of the array.
        got: Vec<usize>,
        /// Shape that the other arrays or the task require.
        expected: Vec<usize>,
    },
    /// Array with an infinity or a NaN.
    #[error("the array `{name}` has a value that is not finite at index {index} (row-major order)")]
    NotFinite {
        /// Name of the array.
        name: &'static str,
        /// Index into the array's values in row-major order.
        index: usize,
    },
}

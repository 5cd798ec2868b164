//! Errors of loading a model and of finding names in it.

/// Why a model could not be loaded, or a name not be found in it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The library at run time is of another release than the header at build time.
    #[error(
        "MuJoCo's header is of version {header} but the linked library is of version {library}; \
         rebuild against the library that is installed (Debian package libmujoco-dev 2.2.2)"
    )]
    VersionMismatch {
        /// `mjVERSION_HEADER` at build time, e.g. 222.
        header: i32,
        /// `mj_version()` at run time.
        library: i32,
    },
    /// MuJoCo refused the model; its own message follows.
    #[error("MuJoCo cannot load `{file}`: {message}")]
    Load {
        /// Name of the main file.
        file: String,
        /// MuJoCo's message, with file and line where it knows them.
        message: String,
    },
    /// A file name that MuJoCo's virtual file system cannot hold.
    #[error("file name `{name}` cannot be used: {reason}")]
    FileName {
        /// The name as given.
        name: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// A file without content, or of 2 GiB and more.
    #[error("file `{name}` has {size} bytes; a file must have between 1 and 2147483647")]
    FileSize {
        /// The file's name.
        name: String,
        /// Its size in bytes.
        size: usize,
    },
    /// The main file is not among the files.
    #[error("main file `{main}` is not among the files given: {}", list(.files))]
    NoMainFile {
        /// Name asked for.
        main: String,
        /// Names of the files given.
        files: Vec<String>,
    },
    /// No object of this kind has this name.
    #[error("the model has no {kind} named `{name}`; known: {}", list(.known))]
    UnknownName {
        /// Kind of object, e.g. `body`.
        kind: &'static str,
        /// Name asked for.
        name: String,
        /// Every name of this kind in the model.
        known: Vec<String>,
    },
    /// The body exists, but is not a mocap body.
    #[error("body `{name}` is no mocap body; mocap bodies: {}", list(.known))]
    NotMocap {
        /// Name asked for.
        name: String,
        /// Every mocap body of the model.
        known: Vec<String>,
    },
}

fn list(names: &[String]) -> String {
    if names.is_empty() {
        "(none)".into()
    } else {
        names.join(", ")
    }
}

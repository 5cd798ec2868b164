//! Errors of runs.

use std::path::{Path, PathBuf};

use learner::LearnerError;
use rl::BoxError;

/// Error of the learner, its stream, or the files of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// A setting outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The value given.
        value: String,
        /// What would be accepted.
        expected: &'static str,
    },
    /// The environments.
    #[error(transparent)]
    Env(#[from] envs::EnvError),
    /// Policies and their updates.
    #[error(transparent)]
    Rl(#[from] rl::RlError),
    /// Learners, their settings and their checkpoints.
    #[error(transparent)]
    Learner(LearnerError),
    /// Distances and assignment.
    #[error(transparent)]
    Cluster(#[from] cluster::ClusterError),
    /// Evidence of groups.
    #[error(transparent)]
    Evidence(#[from] evidence::EvidenceError),
    /// The thread pool.
    #[error("cannot start {threads} threads: {source}")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// The reason.
        source: rayon::ThreadPoolBuildError,
    },
    /// A file that is missing, damaged or of another kind.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: BoxError,
    },
    /// A folder that another process writes to.
    #[error(
        "{} is being written to by {holder}: wait until it has ended, or stop it", folder.display()
    )]
    Locked {
        /// The folder.
        folder: PathBuf,
        /// The other process.
        holder: String,
    },
    /// Run that another process took over.
    #[error(transparent)]
    TakenOver(TakenOver),
    /// A folder that holds a run already.
    #[error(
        "{} holds a run already: go on with `covers resume {}`, or overwrite it with \
         `--overwrite`", folder.display(), folder.display()
    )]
    Occupied {
        /// The folder.
        folder: PathBuf,
    },
    /// A folder without a run.
    #[error(
        "{} holds no run: there is no experiment.json and no checkpoint. Begin one with \
         `covers train`",
        folder.display()
    )]
    NoRun {
        /// The folder.
        folder: PathBuf,
    },
    /// A run none of whose checkpoints can be read.
    #[error(
        "no checkpoint in {} is intact ({problems}): put one back, or begin anew with \
         `covers train --config` and the run's experiment.json", folder.display()
    )]
    NoCheckpoint {
        /// The folder.
        folder: PathBuf,
        /// What is wrong with each.
        problems: String,
    },
    /// Table that was changed after its run had ended.
    #[error(
        "{} was changed after the run had ended: its checksum is {found}, summary.json says \
         {expected}. `covers resume` on the run's folder restores all tables but timings.csv from \
         the last checkpoint",
        path.display()
    )]
    ChangedTable {
        /// The table.
        path: PathBuf,
        /// Its checksum.
        found: String,
        /// Checksum when the run ended.
        expected: String,
    },
    /// A run that nothing can be reported of.
    #[error("{} cannot be reported: {problem}", folder.display())]
    UnfitRun {
        /// The run's folder.
        folder: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A panic in a thread that worked for the run.
    #[error("a worker panicked: {message}. The last checkpoint stands: `covers resume` goes on")]
    Panicked {
        /// What it said.
        message: String,
    },
    /// A run that went on after an error.
    #[error(
        "this run ended with an error and may be half changed: go on from its last checkpoint \
         with `covers resume`"
    )]
    Broken,
    /// Limit of memory that is too low for what a command needs.
    #[error(
        "{limit} leaves {left} MiB of memory, and about {needed} MiB are needed: raise it, or use \
         fewer threads"
    )]
    Memory {
        /// Memory that is needed (MiB).
        needed: u64,
        /// Memory that the limit leaves (MiB).
        left: u64,
        /// Name of the limit.
        limit: String,
    },
    /// The handlers of signals.
    #[error("cannot listen to signals: {source}")]
    Signals {
        /// The reason.
        source: std::io::Error,
    },
    /// A file that would be overwritten.
    #[error("{} exists already: choose another name, or remove it", path.display())]
    FileExists {
        /// The file.
        path: PathBuf,
    },
    /// A file of the run folder.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The reason.
        source: BoxError,
    },
}

/// Errors that the learner shares with the rest of the program keep one form.
impl From<LearnerError> for RunError {
    fn from(error: LearnerError) -> Self {
        match error {
            LearnerError::Setting { name, value, expected } => {
                Self::Setting { name, value, expected }
            }
            LearnerError::Rl(error) => Self::Rl(error),
            LearnerError::Cluster(error) => Self::Cluster(error),
            LearnerError::Evidence(error) => Self::Evidence(error),
            LearnerError::Read { path, source } => Self::Read { path, source },
            LearnerError::Write { path, source } => Self::write(&path, source),
            other => Self::Learner(other),
        }
    }
}

impl RunError {
    /// Wraps what went wrong with reading `path`.
    pub fn read(path: &Path, source: impl Into<BoxError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Read { path, source }
    }

    /// The error of a file that could be read and does not make sense.
    pub fn damaged(path: &Path, problem: String) -> Self {
        Self::read(path, Damaged(problem))
    }

    /// Wraps what went wrong with writing `path`.
    pub fn write(path: &Path, source: impl Into<BoxError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        let inner = source.downcast_ref::<std::io::Error>();
        let inner = inner.and_then(|error| error.get_ref()?.downcast_ref::<TakenOver>());
        match inner {
            Some(taken_over) => Self::TakenOver(taken_over.clone()),
            None => Self::Write { path, source },
        }
    }
}

/// Loss of a run's folder to another process, or of the folder itself.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "{} {}: this process writes nothing more to it",
    folder.display(), taken_over(holder.as_deref())
)]
pub struct TakenOver {
    /// Folder of the run.
    pub folder: PathBuf,
    /// Name of the other process; `None` if the file with its name is gone.
    pub holder: Option<String>,
}

fn taken_over(holder: Option<&str>) -> String {
    match holder {
        Some(holder) => format!("was taken over by {holder}"),
        None => "was moved, or its file `owner` was removed, while this process was working".into(),
    }
}

/// What is wrong with a file that could be read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Damaged(String);

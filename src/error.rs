//! What can go wrong while learning from a stream.

use std::path::PathBuf;

/// Error of the learner, its stream, or the files of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoversError {
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
    /// A rollout that shows too few episodes to be assigned to a policy.
    #[error(
        "the rollout shows the first {first_frames} frames of {got} episodes, expected at least {needed}: \
         use more environments, longer rollouts, or fewer first frames"
    )]
    TooFewEpisodes {
        /// Episodes that showed all of their first frames.
        got: usize,
        /// Episodes that the assigner needs.
        needed: usize,
        /// Frames looked at in each.
        first_frames: usize,
    },
    /// The environments.
    #[error(transparent)]
    Env(#[from] envs::EnvError),
    /// Policies and their updates.
    #[error(transparent)]
    Rl(#[from] rl::RlError),
    /// Distances and assignment.
    #[error(transparent)]
    Cluster(#[from] cluster::ClusterError),
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
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A checkpoint of [`Extent::Policies`](crate::Extent::Policies), which leaves out what
    /// learning on takes.
    #[error(
        "{} holds policies only, as `covers pack` leaves them, and cannot be resumed: \
         resume the run's own folder; `covers eval` takes either", path.display()
    )]
    PoliciesOnly {
        /// The checkpoint.
        path: PathBuf,
    },
    /// A file of the run folder.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl CoversError {
    /// Wraps what went wrong with reading `path`.
    pub(crate) fn read(
        path: &std::path::Path,
        source: impl std::error::Error + Send + Sync + 'static,
    ) -> Self {
        Self::Read {
            path: path.to_owned(),
            source: Box::new(source),
        }
    }

    /// The error of a file that could be read and does not make sense.
    pub(crate) fn damaged(path: &std::path::Path, problem: String) -> Self {
        Self::read(path, Damaged(problem))
    }

    /// This error of a file's contents; those of files and environments stay as they are.
    pub(crate) fn in_file(self, path: &std::path::Path) -> Self {
        match self {
            Self::Rl(_) | Self::Cluster(_) | Self::Setting { .. } => Self::read(path, self),
            other => other,
        }
    }

    /// Wraps what went wrong with writing `path`.
    pub(crate) fn write(
        path: &std::path::Path,
        source: impl std::error::Error + Send + Sync + 'static,
    ) -> Self {
        Self::Write {
            path: path.to_owned(),
            source: Box::new(source),
        }
    }
}

/// What is wrong with a file that could be read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Damaged(String);

//! Errors of learners, their settings and their checkpoints.

use std::path::{Path, PathBuf};

use rl::BoxError;

/// Error of a learner, its settings, or its checkpoints.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnerError {
    /// A setting outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Rejected value.
        value: String,
        /// Valid values, in words.
        expected: &'static str,
    },
    /// A rollout that shows too few episodes to be assigned to a policy.
    #[error(
        "the rollout shows the first {first_frames} frames of {got} episodes, expected at least {needed}: \
         use more environments, longer rollouts, or fewer first frames"
    )]
    TooFewEpisodes {
        /// Number of episodes with all of their first frames.
        got: usize,
        /// Episodes that the assigner needs.
        needed: usize,
        /// Number of first frames of each episode.
        first_frames: usize,
    },
    /// Policies and their updates.
    #[error(transparent)]
    Rl(#[from] rl::RlError),
    /// Distances and assignment.
    #[error(transparent)]
    Cluster(#[from] cluster::ClusterError),
    /// Evidence of groups.
    #[error(transparent)]
    Evidence(#[from] evidence::EvidenceError),
    /// A file that is missing, damaged or of another kind.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: BoxError,
    },
    /// A checkpoint of [`Extent::Policies`](crate::Extent::Policies), which lacks the
    /// state for further training.
    #[error(
        "{} holds policies only, as `covers pack` leaves them, and cannot be resumed: \
         resume the run's own folder; `covers eval` takes either", path.display()
    )]
    PoliciesOnly {
        /// The checkpoint.
        path: PathBuf,
    },
    /// A checkpoint of a newer version of this crate.
    #[error(
        "{} has format {format}, this version of covers reads {known}: resume it with the version \
         that wrote it", path.display()
    )]
    NewerFormat {
        /// The checkpoint.
        path: PathBuf,
        /// Format of the checkpoint.
        format: u32,
        /// The newest format that this version reads.
        known: u32,
    },
    /// A number that is not finite, on its way into a checkpoint.
    #[error(
        "`{tensor}`[{index}] is {value}: nothing was written to {}, and the last checkpoint stands. \
         Begin a new run with a smaller learning rate (`--set covers.ppo.head_learning_rate=...` \
         or `--set off_policy.sac.learning_rate=...`)",
        path.display()
    )]
    NotFinite {
        /// The checkpoint.
        path: PathBuf,
        /// The array.
        tensor: String,
        /// The number's place in it.
        index: usize,
        /// The value.
        value: f32,
    },
    /// A setting that does not exist.
    #[error("there is no setting `{name}`{}", hint(nearest))]
    UnknownSetting {
        /// Path of the setting.
        name: String,
        /// The setting that is most like it.
        nearest: Option<String>,
    },
    /// Settings that are no JSON.
    #[error("the settings are no JSON: {source}")]
    NotJson {
        /// Position and reason.
        source: serde_json::Error,
    },
    /// A setting of the wrong type.
    #[error("setting `{path}`: {problem}")]
    WrongSetting {
        /// Path of the setting.
        path: String,
        /// Part that does not fit.
        problem: String,
    },
    /// An override without a value.
    #[error("`{text}` sets nothing: expected PATH=VALUE, as covers.ppo.gamma=0.97")]
    NotAnOverride {
        /// Text that was given.
        text: String,
    },
    /// A checkpoint of other settings than those asked for.
    #[error(
        "{} was written with other settings than those asked for ({differences}): put them back, or \
         begin a new run with the settings that you want", path.display()
    )]
    OtherSettings {
        /// The checkpoint.
        path: PathBuf,
        /// Differences: the value asked for and the checkpoint's.
        differences: String,
    },
    /// A learner that has no policies for other programs.
    #[error("this learner's policies cannot be written for other programs")]
    Unexportable,
    /// A file of the run folder.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The reason.
        source: BoxError,
    },
}

impl LearnerError {
    /// Wraps an error of reading `path`.
    pub fn read(path: &Path, source: impl Into<BoxError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Read { path, source }
    }

    /// Returns the error of a file that could be read but is inconsistent.
    pub fn damaged(path: &Path, problem: String) -> Self {
        Self::read(path, Damaged(problem))
    }

    /// Wraps an error of writing `path`.
    pub fn write(path: &Path, source: impl Into<BoxError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Write { path, source }
    }

    /// Names `path` in an error of a file's contents; other errors stay as they are.
    pub(crate) fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Rl(_) | Self::Cluster(_) | Self::Setting { .. } => Self::read(path, self),
            other => other,
        }
    }
}

fn hint(nearest: &Option<String>) -> String {
    match nearest {
        Some(nearest) => format!(": did you mean `{nearest}`?"),
        None => String::new(),
    }
}

/// Problem of a file that could be read.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Damaged(String);

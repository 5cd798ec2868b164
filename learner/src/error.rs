//! Errors of learners, their settings and their checkpoints.

use std::path::{Path, PathBuf};

use rl::BoxedEnvError;

/// Error of a learner, its settings, or its checkpoints.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnerError {
    /// Setting of a learner outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    InvalidSetting {
        /// Name of the setting that is out of range.
        name: &'static str,
        /// Rejected value of the setting.
        value: String,
        /// Valid values of the setting, in words.
        expected: &'static str,
    },
    /// Rollout that shows too few episodes to be assigned to a policy.
    #[error(
        "the rollout shows the first {first_frames} frames of {got} episodes, expected at least {needed}: \
         use more environments, longer rollouts, or fewer first frames"
    )]
    TooFewEpisodes {
        /// Number of the rollout's episodes that have at least `first_frames` frames.
        got: usize,
        /// Number of episodes that the grouping needs to assign the rollout to a policy.
        needed: usize,
        /// Number of first frames that each episode must show.
        first_frames: usize,
    },
    /// Error of a policy or of its training.
    #[error(transparent)]
    Rl(#[from] rl::RlError),
    /// Error of a Wasserstein distance, or of the assignment of a rollout to a policy.
    #[error(transparent)]
    Cluster(#[from] cluster::ClusterError),
    /// Error of the comparison of episodes by images, motion and returns.
    #[error(transparent)]
    Evidence(#[from] evidence::EvidenceError),
    /// Settings file or checkpoint that is missing, damaged or of another kind.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Path of the file that cannot be read.
        path: PathBuf,
        /// Reason why the file cannot be read.
        source: BoxedEnvError,
    },
    /// Checkpoint of [`CheckpointExtent::Policies`](crate::CheckpointExtent::Policies), which lacks
    /// the state for further training.
    #[error(
        "{} holds policies only, as `covers pack` leaves them, and cannot be resumed: \
         resume the run's own folder; `covers eval` takes either", path.display()
    )]
    PoliciesOnlyCheckpoint {
        /// Path of the checkpoint.
        path: PathBuf,
    },
    /// Checkpoint of a newer version of this crate.
    #[error(
        "{} has format {format}, this version of covers reads {known}: resume it with the version \
         that wrote it", path.display()
    )]
    NewerFormat {
        /// Path of the checkpoint.
        path: PathBuf,
        /// Number of the checkpoint's file format.
        format: u32,
        /// Newest number of a file format that this version reads.
        known: u32,
    },
    /// Intact checkpoint whose settings have other fields than those of the method that reads it.
    #[error(
        "{} is intact, but of another method or another build of covers ({}): put back the \
         experiment.json that belongs to it, or begin a new run",
        path.display(),
        problem.split(',').next().unwrap_or(problem)
    )]
    OtherMethod {
        /// Path of the checkpoint.
        path: PathBuf,
        /// First difference between the settings, as the JSON parser describes it.
        problem: String,
    },
    /// Infinite or NaN number in a learner's state, found while a checkpoint is written.
    #[error(
        "`{tensor}`[{index}] is {value}: nothing was written to {}, and the last checkpoint stands. \
         Begin a new run with a smaller learning rate (`--set covers.ppo.head_learning_rate=...` \
         or `--set off_policy.sac.learning_rate=...`)",
        path.display()
    )]
    NotFinite {
        /// Path of the checkpoint.
        path: PathBuf,
        /// Name of the array that holds the number.
        tensor: String,
        /// Index of the number in the flat array.
        index: usize,
        /// Infinite or NaN value.
        value: f32,
    },
    /// Path of a setting that does not exist.
    #[error("there is no setting `{name}`{}{}", methods.unwrap_or(""), hint(nearest))]
    UnknownSetting {
        /// Path of the setting, as given.
        name: String,
        /// Remark on the methods that have such settings, if this one has none.
        methods: Option<&'static str>,
        /// Path of the existing setting with the most similar name.
        nearest: Option<String>,
    },
    /// Text of settings that is no valid JSON.
    #[error("the settings are not valid JSON: {source}")]
    NotJson {
        /// Error of the JSON parser, with position and reason.
        source: serde_json::Error,
    },
    /// Setting with a value of the wrong type.
    #[error("{}{problem}{}", place(path), choice_hint(nearest))]
    WrongSetting {
        /// Path of the setting; `.` for all settings.
        path: String,
        /// Description of the part of the value that does not fit.
        problem: String,
        /// Most similar name, if the value is an unknown name.
        nearest: Option<String>,
    },
    /// Override without a value, where `PATH=VALUE` is expected.
    #[error("`{text}` sets nothing: expected PATH=VALUE, as off_policy.sac.gamma=0.97")]
    NotAnOverride {
        /// Text of the override, as given.
        text: String,
    },
    /// Checkpoint of other settings than those asked for.
    #[error(
        "{} was written with other settings than those asked for ({differences}): put them back, or \
         begin a new run with the settings that you want", path.display()
    )]
    CheckpointSettingsDiffer {
        /// Path of the checkpoint.
        path: PathBuf,
        /// Settings that differ, as text: path, value asked for and value in the checkpoint.
        differences: String,
    },
    /// Request to export a policy of a learner that has none for other programs.
    #[error("this learner's policies cannot be written for other programs")]
    Unexportable,
    /// File of the run folder that cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Path of the file or folder.
        path: PathBuf,
        /// Reason why the file cannot be written.
        source: BoxedEnvError,
    },
}

impl LearnerError {
    /// Returns the error of a setting outside its range.
    pub(crate) fn invalid(
        name: &'static str,
        value: impl ToString,
        expected: &'static str,
    ) -> Self {
        Self::InvalidSetting { name, value: value.to_string(), expected }
    }

    /// Wraps an error of reading the file at `path`.
    pub fn cannot_read(path: &Path, source: impl Into<BoxedEnvError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Read { path, source }
    }

    /// Returns the error of a file that could be read but is inconsistent.
    pub fn damaged_file(path: &Path, problem: String) -> Self {
        Self::cannot_read(path, problem)
    }

    /// Wraps an error of writing the file at `path`.
    pub fn cannot_write(path: &Path, source: impl Into<BoxedEnvError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Write { path, source }
    }

    /// Adds the path of a file to an error of its contents; other errors stay as they are.
    pub(crate) fn with_path(self, path: &Path) -> Self {
        match self {
            Self::Rl(_) | Self::Cluster(_) | Self::Evidence(_) | Self::InvalidSetting { .. } => {
                Self::cannot_read(path, self)
            }
            other => other,
        }
    }
}

fn place(path: &str) -> String {
    if path == "." { String::new() } else { format!("setting `{path}`: ") }
}

fn choice_hint(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}

fn hint(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |name| format!(": did you mean `{name}`?"))
}

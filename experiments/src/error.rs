//! Errors of experiments and run folders.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use learner::LearnerError;
use rl::BoxedEnvError;

/// Error of the learner, its stream, or the files of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// Setting whose value is outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    InvalidSetting {
        /// Name of the setting.
        name: &'static str,
        /// Rejected value of the setting.
        value: String,
        /// Description of the setting's accepted values.
        expected: &'static str,
    },
    /// Setting of a run whose value is outside its range, with its path and its default.
    #[error("setting `{path}` is {value}, expected {expected} ({default} with `{preset}`)")]
    SettingOutOfRange {
        /// Path of the setting, as `--set` takes it.
        path: String,
        /// Rejected value of the setting.
        value: String,
        /// Description of the setting's accepted values.
        expected: &'static str,
        /// Options that select the preset that is most like the run.
        preset: String,
        /// Value of the setting in that preset.
        default: String,
    },
    /// Error of the environments.
    #[error(transparent)]
    Env(#[from] envs::EnvError),
    /// Error of a policy or its update.
    #[error(transparent)]
    Rl(#[from] rl::RlError),
    /// Error of a learner, its settings or its checkpoints.
    #[error(transparent)]
    Learner(LearnerError),
    /// Error of Wasserstein distances or of the assignment of rollouts to policies by them.
    #[error(transparent)]
    Cluster(#[from] cluster::ClusterError),
    /// Error of the recogniser, which assigns rollouts to policies by summaries of whole episodes.
    #[error(transparent)]
    Evidence(#[from] evidence::EvidenceError),
    /// Pool of worker threads that cannot be started.
    #[error("cannot start {threads} threads: {source}. Ask for fewer with `--threads`")]
    Threads {
        /// Number of threads that the pool should have.
        threads: usize,
        /// Error of the thread library.
        source: rayon::ThreadPoolBuildError,
    },
    /// File of a run that is missing, damaged or of another kind.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Path of the file that cannot be read.
        path: PathBuf,
        /// Cause for which the file cannot be read.
        source: BoxedEnvError,
    },
    /// Folder of a run that another process writes to.
    #[error(
        "{} is being written to by {holder}: wait until it has ended, or stop it", folder.display()
    )]
    Locked {
        /// Path of the locked folder.
        folder: PathBuf,
        /// Name of the process that holds the lock.
        holder: String,
    },
    /// Run that another process took over.
    #[error(transparent)]
    TakenOver(TakenOver),
    /// Folder that already holds a run.
    #[error(
        "{} holds a run already: continue it with `covers resume {}`, or replace it with \
         `--overwrite`", folder.display(), folder.display()
    )]
    FolderHoldsRun {
        /// Folder that holds the run.
        folder: PathBuf,
    },
    /// Name of a task group that the run does not have.
    #[error(
        "the run has no group `{name}`{}: its groups are {}",
        nearest.as_ref().map_or_else(String::new, |of| format!(" (did you mean `{of}`?)")),
        groups.join(", ")
    )]
    UnknownGroup {
        /// Name, as given.
        name: String,
        /// Most similar name of a group of the run.
        nearest: Option<String>,
        /// Names of the run's groups.
        groups: Vec<String>,
    },
    /// Folder that holds no run.
    #[error(
        "{} holds no run: there is no experiment.json and no checkpoint. {}",
        folder.display(),
        match inside {
            Some(run) => format!("It holds folders of runs: name one, such as {}", run.display()),
            None => "Start one with `covers train`".to_owned(),
        }
    )]
    NoRun {
        /// Folder without a run.
        folder: PathBuf,
        /// First of the runs whose folders lie in the folder.
        inside: Option<PathBuf>,
    },
    /// Packed folder where the history of a training is needed.
    #[error(
        "{} holds policies without the history of their training: `covers pack` keeps none. \
         Score them with `covers eval`, or name the run that was packed",
        folder.display()
    )]
    PackedRun {
        /// Packed folder.
        folder: PathBuf,
    },
    /// Run whose folder holds no intact checkpoint.
    #[error(
        "no checkpoint in {} is intact ({problems}): restore one from a copy, or start again with \
         `covers train --config` and the run's experiment.json", folder.display()
    )]
    NoCheckpoint {
        /// Folder of the run or of its checkpoints.
        folder: PathBuf,
        /// Error message of each checkpoint that could not be read.
        problems: String,
    },
    /// Run whose folder holds no checkpoint.
    #[error(
        "{} holds no checkpoint: a run writes the first one after as many rollouts as \
         `checkpoints.every` in experiment.json; of a run that has ended, restore a copy",
        folder.display()
    )]
    WithoutCheckpoints {
        /// Folder of the run.
        folder: PathBuf,
    },
    /// Run whose newest checkpoint is damaged, while an older one is intact.
    #[error(
        "the newest checkpoint is damaged ({problems}): repair the run with `covers resume {}`, or \
         remove the damaged file to use the older {}",
        folder.display(),
        intact.display()
    )]
    DamagedCheckpoint {
        /// Folder of the run.
        folder: PathBuf,
        /// Error message of each newer checkpoint that could not be read.
        problems: String,
        /// Path of the newest intact checkpoint.
        intact: PathBuf,
    },
    /// Table of a finished run that was changed after the run had ended.
    #[error(
        "{} was changed after the run had ended: its checksum is {found}, summary.json says \
         {expected}. `covers resume` on the run's folder restores all tables from the last \
         checkpoint",
        path.display()
    )]
    ChangedTable {
        /// Path of the table.
        path: PathBuf,
        /// Checksum of the table as it is now.
        found: String,
        /// Checksum of the table when the run ended.
        expected: String,
    },
    /// Robot that is not the one with which the run began.
    #[error(
        "the robot that {} describes has changed since the run in {} began: its checksum is \
         {found}, provenance.jsonl says {expected}. Restore the file, its URDF and its meshes, or \
         begin another run",
        robot.display(), folder.display()
    )]
    ChangedRobot {
        /// File that describes the robot.
        robot: PathBuf,
        /// Folder of the run.
        folder: PathBuf,
        /// Checksum of the robot as it is now.
        found: String,
        /// Checksum of the robot when the run began.
        expected: String,
    },
    /// Run whose files a report cannot be made from.
    #[error("{} cannot be reported: {problem}", folder.display())]
    UnreportableRun {
        /// Folder of the run.
        folder: PathBuf,
        /// Description of the problem that prevents a report.
        problem: String,
    },
    /// Ranks (processes that compute one run together) that are not in the same state.
    #[error(
        "the ranks {what} {values:?}, expected equal numbers: all must read the same folder, and \
         have the same program and processors with the same vector instructions"
    )]
    RanksDiffer {
        /// Description of the numbers, which must be equal on all ranks.
        what: &'static str,
        /// Number that each rank has.
        values: Vec<u64>,
    },
    /// Panic in a thread that worked for the run.
    #[error(
        "a worker thread panicked: {message}. Nothing up to the last checkpoint is lost: continue \
         with `covers resume`"
    )]
    Panicked {
        /// Message of the panic.
        message: String,
    },
    /// Run that was used again after an error.
    #[error(
        "this run ended with an error and may be half changed: continue from its last checkpoint \
         with `covers resume`"
    )]
    FailedEarlier,
    /// Memory limit that is too low for a command.
    #[error(
        "{limit} leaves {left_mib} MiB, and about {needed_mib} MiB of memory are needed: raise it, \
         use fewer threads, or close other programs"
    )]
    NotEnoughMemory {
        /// Memory that the command needs (MiB).
        needed_mib: u64,
        /// Memory that the limit leaves for the command (MiB).
        left_mib: u64,
        /// Name of the limit that leaves too little memory.
        limit: String,
    },
    /// Signal handlers that cannot be installed.
    #[error("cannot install handlers for signals: {source}")]
    SignalHandlers {
        /// Error of the operating system.
        source: io::Error,
    },
    /// Output file that exists already and would be overwritten.
    #[error("{} exists already: choose another name, or remove it", path.display())]
    FileExists {
        /// Path of the existing file.
        path: PathBuf,
    },
    /// Run that its disk has no room for.
    #[error(
        "cannot write {}: {source}. {}Make room, then continue with `covers resume {}{device_option}`",
        path.display(),
        room_needed(*checkpoint_bytes),
        folder.display()
    )]
    DiskFull {
        /// Path of the file that cannot be written.
        path: PathBuf,
        /// Error of the operating system.
        source: BoxedEnvError,
        /// Folder of the run.
        folder: PathBuf,
        /// Option of `covers resume` for the run's device, see
        /// [`Run::device_option`](crate::Run::device_option).
        device_option: &'static str,
        /// Size of the run's next checkpoint (bytes), or of its newest one; `None` before the
        /// first.
        checkpoint_bytes: Option<u64>,
    },
    /// File or folder that cannot be written.
    #[error("cannot write {}: {source}{}", path.display(), full_disk_remedy(source))]
    Write {
        /// Path of the file or folder that cannot be written.
        path: PathBuf,
        /// Cause for which the file cannot be written.
        source: BoxedEnvError,
    },
}

/// Conversion that maps variants which both enums have onto each other, so that callers match one.
impl From<LearnerError> for RunError {
    fn from(error: LearnerError) -> Self {
        match error {
            LearnerError::InvalidSetting { name, value, expected } => {
                Self::InvalidSetting { name, value, expected }
            }
            LearnerError::Rl(error) => Self::Rl(error),
            LearnerError::Cluster(error) => Self::Cluster(error),
            LearnerError::Evidence(error) => Self::Evidence(error),
            LearnerError::Read { path, source } => Self::Read { path, source },
            LearnerError::Write { path, source } => Self::cannot_write(&path, source),
            other => Self::Learner(other),
        }
    }
}

impl RunError {
    /// Returns a [`RunError::InvalidSetting`].
    pub fn invalid(name: &'static str, value: impl ToString, expected: &'static str) -> Self {
        Self::InvalidSetting { name, value: value.to_string(), expected }
    }

    /// Returns a [`RunError::Read`] for the file at `path`, which could not be read because of
    /// `source`.
    pub fn cannot_read(path: &Path, source: impl Into<BoxedEnvError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        Self::Read { path, source }
    }

    /// Returns a function that converts a cause to a [`RunError::Read`] for the file at `path`.
    pub fn read_error_mapper<E: Into<BoxedEnvError>>(path: &Path) -> impl Fn(E) -> Self {
        move |source| Self::cannot_read(path, source)
    }

    /// Returns a function that converts a cause to a [`RunError::Write`] for the file at `path`, as
    /// [`RunError::cannot_write`] does.
    pub fn write_error_mapper<E: Into<BoxedEnvError>>(path: &Path) -> impl Fn(E) -> Self {
        move |source| Self::cannot_write(path, source)
    }

    /// Returns a [`RunError::Read`] for a file that can be read but has invalid contents.
    pub fn damaged_file(path: &Path, problem: String) -> Self {
        LearnerError::damaged_file(path, problem).into()
    }

    /// Returns `true` for a disk error that may pass by itself: a full disk, or a file server that
    /// does not answer.
    pub fn is_transient(&self) -> bool {
        /// Number of the system's error "Input/output error" (`EIO`), which has no `ErrorKind`.
        const INPUT_OUTPUT: i32 = 5;
        let (Self::Read { source, .. }
        | Self::Write { source, .. }
        | Self::DiskFull { source, .. }) = self
        else {
            return false;
        };
        source.downcast_ref::<io::Error>().is_some_and(|error| {
            error.raw_os_error() == Some(INPUT_OUTPUT)
                || is_full(error)
                || matches!(
                    error.kind(),
                    ErrorKind::StaleNetworkFileHandle
                        | ErrorKind::TimedOut
                        | ErrorKind::HostUnreachable
                        | ErrorKind::NetworkUnreachable
                        | ErrorKind::NetworkDown
                        | ErrorKind::ResourceBusy
                )
        })
    }

    /// Returns `true` for an error of access to a file, which says nothing about its contents.
    pub(crate) fn is_about_access(&self) -> bool {
        /// Numbers of the system's errors "Too many open files", of the process (`EMFILE`) and of
        /// the system (`ENFILE`).
        const TOO_MANY_FILES: [i32; 2] = [24, 23];
        let cause = match self {
            Self::Read { source, .. } => source.downcast_ref::<io::Error>(),
            _ => None,
        };
        self.is_transient()
            || cause.is_some_and(|error| {
                let of_access = [ErrorKind::PermissionDenied, ErrorKind::OutOfMemory];
                of_access.contains(&error.kind())
                    || error.raw_os_error().is_some_and(|own| TOO_MANY_FILES.contains(&own))
            })
    }

    /// Converts a [`RunError::Write`] on a full disk to [`RunError::DiskFull`] of the run in
    /// `folder`; other errors stay as they are.
    pub(crate) fn on_full_disk(
        self,
        folder: &Path,
        device_option: &'static str,
        checkpoint_bytes: Option<u64>,
    ) -> Self {
        match self {
            Self::Write { path, source } if is_full_disk(&source) => {
                let folder = folder.to_owned();
                Self::DiskFull { path, source, folder, device_option, checkpoint_bytes }
            }
            other => other,
        }
    }

    /// Returns a [`RunError::Write`] for the file at `path`, or [`RunError::TakenOver`] if that is
    /// the cause.
    pub fn cannot_write(path: &Path, source: impl Into<BoxedEnvError>) -> Self {
        let (path, source) = (path.to_owned(), source.into());
        // a fenced disk can return nothing but an `io::Error`, so the cause is inside of it
        let taken_over = source
            .downcast_ref::<io::Error>()
            .and_then(|error| error.get_ref()?.downcast_ref::<TakenOver>());
        match taken_over {
            Some(taken_over) => Self::TakenOver(taken_over.clone()),
            None => Self::Write { path, source },
        }
    }
}

fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded)
}

fn is_full_disk(source: &BoxedEnvError) -> bool {
    source.downcast_ref::<io::Error>().is_some_and(is_full)
}

fn full_disk_remedy(source: &BoxedEnvError) -> &'static str {
    if is_full_disk(source) { ": make room, then repeat the command" } else { "" }
}

fn room_needed(checkpoint_bytes: Option<u64>) -> String {
    let needed = |bytes| format!("A checkpoint needs at least {:.1} MB. ", bytes as f64 / 1e6);
    checkpoint_bytes.map_or_else(String::new, needed)
}

/// Error of a writer whose run folder was taken over by another process, or moved away.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "{} {}: this process writes nothing more to it",
    folder.display(), taken_over(holder.as_deref())
)]
pub struct TakenOver {
    /// Folder of the run that another process took over.
    pub folder: PathBuf,
    /// Name of the process that took the run over; `None` if the file with its name is gone.
    pub holder: Option<String>,
}

fn taken_over(holder: Option<&str>) -> String {
    match holder {
        Some(holder) => format!("was taken over by {holder}"),
        None => "was moved, or its file `owner` was removed, while this process was working".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_answered_with_the_need_and_the_remedy() {
        let error =
            |kind: ErrorKind| RunError::cannot_write(Path::new("out"), io::Error::from(kind));
        let full = error(ErrorKind::StorageFull);
        assert!(full.is_transient());
        let repeat = full.to_string();
        assert!(repeat.ends_with(": make room, then repeat the command"), "{repeat}");
        let of_run = full.on_full_disk(Path::new("runs/a"), " --device gpu", Some(12_340_000));
        assert!(of_run.is_transient());
        let message = of_run.to_string();
        let expected = ". A checkpoint needs at least 12.3 MB. Make room, then continue with \
            `covers resume runs/a --device gpu`";
        assert!(message.ends_with(expected), "{message}");
        let other = error(ErrorKind::PermissionDenied).on_full_disk(Path::new("runs/a"), "", None);
        assert!(!other.to_string().contains("room"), "{other}");
    }
}

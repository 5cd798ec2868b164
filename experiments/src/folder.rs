//! Folder of one run: settings as JSON, tables as CSV, images as PNG, learners as safetensors.

use std::collections::BTreeMap;
use std::fs::{create_dir, create_dir_all, read_dir};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use rl::{EnvSpec, ProcessRanks};
use serde::Deserialize;

use crate::error::RunError;
use crate::evaluation::OwnPolicyByGroup;
use crate::experiment::Experiment;
use crate::sheet::Picture;
use learner::disk::{
    Disk, LocalDisk, NoDisk, PARTIAL_FILE_EXTENSION, parent_folder, write_atomically,
};
use learner::{CheckpointExtent, Learner, LearnerSettings, TaskLabel};

use super::checkpoints;
use crate::lock::{self, FolderLock, LOCK};
use crate::note::SavedRun;
use crate::provenance::{Provenance, crc32_hex, robot_checksum};

/// Name of the file with a run's settings.
const EXPERIMENT: &str = "experiment.json";
/// Name of the file of a run's summary, which exists if and only if the run has finished.
pub const SUMMARY_FILE: &str = "summary.json";
/// Name of the table of wall-clock seconds per rollout, which checkpoints do not hold.
pub(crate) const TIMINGS_FILE: &str = "timings.csv";
/// Name of the copy of the timings that is written with every checkpoint, and from which they are
/// restored. Checkpoints of equal runs are equal, so the copy cannot be inside them.
pub(crate) const SAVED_TIMINGS_FILE: &str = "timings-saved.csv";
const TABLES: [&str; 5] =
    ["evaluation.csv", "metrics.csv", "recognition.csv", TIMINGS_FILE, "units.csv"];
/// Names of the files of a run, without its settings and checkpoints.
const FILES: [&str; 10] = [
    "contact_sheet.png",
    "evaluation.csv",
    "log.txt",
    "metrics.csv",
    "provenance.jsonl",
    "recognition.csv",
    SUMMARY_FILE,
    SAVED_TIMINGS_FILE,
    TIMINGS_FILE,
    "units.csv",
];

/// Names, lengths and modification times of the files of a run, to be compared with a later
/// snapshot: no clock of another machine decides anything.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileStamps(Vec<FileState>);

/// State of one file, without length and time if it was removed since it was listed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct FileState {
    path: PathBuf,
    length: Option<u64>,
    modified: Option<SystemTime>,
}

/// Folder of one run. A lock ensures that a single process writes to it.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// File system through which the run's folder is changed.
    disk: Arc<dyn Disk>,
    /// File system without the check of the folder's lock, below the
    /// [`FencedDisk`](crate::lock::FencedDisk); equal to `disk` without lock.
    unfenced: Arc<dyn Disk>,
    overwrite: bool,
    ranks: ProcessRanks,
}

/// Returns `true` if a file or folder exists; `false` below a path that is no folder.
///
/// # Errors
/// [`RunError::Read`] where that cannot be found out.
pub(crate) fn file_exists(path: &Path) -> Result<bool, RunError> {
    match path.try_exists() {
        Err(error) if error.kind() == ErrorKind::NotADirectory => Ok(false),
        found => found.map_err(RunError::read_error_mapper(path)),
    }
}

impl RunFolder {
    /// Creates the folder `parent/name` for a run, or `parent/name-2`, `-3`, ... if that exists, so
    /// that no run overwrites another.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn create(parent: &Path, name: &str) -> Result<Self, RunError> {
        create_dir_all(parent).map_err(RunError::write_error_mapper(parent))?;
        let mut attempt = 1;
        loop {
            let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
            let path = parent.join(format!("{name}{suffix}"));
            match create_dir(&path) {
                Ok(()) => return Ok(Self::from_path(&path)),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => attempt += 1,
                Err(error) => return Err(RunError::cannot_write(&path, error)),
            }
        }
    }

    /// Returns the path of the run's folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns a handle to a run's folder without accessing it.
    pub fn from_path(path: &Path) -> Self {
        let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
        let (path, unfenced, ranks) = (path.to_owned(), Arc::clone(&disk), ProcessRanks::default());
        Self { path, unfenced, disk, overwrite: false, ranks }
    }

    /// Sets the file system through which the run's folder is changed.
    pub fn with_disk(mut self, disk: Arc<dyn Disk>) -> Self {
        self.unfenced = Arc::clone(&disk);
        self.disk = disk;
        self
    }

    /// Sets the ranks, the processes that compute the run together; on ranks but the first, the
    /// handle changes no files.
    pub fn with_process_ranks(self, ranks: ProcessRanks) -> Self {
        let folder = Self { ranks, ..self };
        if folder.ranks.is_first() { folder } else { folder.with_disk(Arc::new(NoDisk)) }
    }

    /// Returns the ranks, which are the processes that compute the run together.
    pub fn process_ranks(&self) -> &ProcessRanks {
        &self.ranks
    }

    /// Locks the folder for writing, on the first rank. Returns the lock and a handle whose changes
    /// all fail once another process has taken the run over.
    ///
    /// # Errors
    /// [`RunError::Locked`], [`RunError::Write`].
    pub(crate) fn lock(mut self) -> Result<(Self, Option<FolderLock>), RunError> {
        if !self.ranks.is_first() {
            return Ok((self, None));
        }
        let lock = FolderLock::acquire(&self.path)?;
        self.disk = Arc::new(lock.fenced_disk(Arc::clone(&self.unfenced)));
        Ok((self, Some(lock)))
    }

    /// Returns the names, lengths and modification times of the run's files, which change as long
    /// as a process works on the run.
    ///
    /// # Errors
    /// [`RunError::Read`].
    pub fn file_stamps(&self) -> Result<FileStamps, RunError> {
        let mut files = Vec::new();
        for folder in [self.path.clone(), self.checkpoint_folder()] {
            let read = |error| RunError::cannot_read(&folder, error);
            let entries = match read_dir(&folder) {
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                entries => entries.map_err(read)?,
            };
            for entry in entries {
                let path = entry.map_err(read)?.path();
                let metadata = path.symlink_metadata().ok();
                let length = metadata.as_ref().map(std::fs::Metadata::len);
                let modified = metadata.and_then(|file| file.modified().ok());
                files.push(FileState { path, length, modified });
            }
        }
        files.sort_unstable();
        Ok(FileStamps(files))
    }

    /// Returns `true` if a process is writing to the folder; `None` where that cannot be found out,
    /// as on file systems without locks.
    pub fn is_in_use(&self) -> Option<bool> {
        lock::is_locked(&self.path)
    }

    /// Removes the lock on the run's folder without asking its holder, which should be a stopped or
    /// unreachable process. Should the process go on later, its next change of a file fails with
    /// [`RunError::TakenOver`] once another process has taken the lock.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn break_lock(&self) -> Result<(), RunError> {
        // the system's lock is on the file, not on its name, so a new file of this name is free
        self.remove(&self.file_path(LOCK))
    }

    /// Allows a new run to start in the folder even if it holds another run, whose files are
    /// removed when the new one starts.
    pub fn allow_overwriting(mut self) -> Self {
        self.overwrite = true;
        self
    }

    /// Rejects a folder in which no new run may start: it holds a run, or files that a run would
    /// replace, and may not be overwritten.
    ///
    /// # Errors
    /// [`RunError::FolderHoldsRun`], [`RunError::FileExists`], [`RunError::Read`].
    pub(crate) fn check_accepts_new_run(&self) -> Result<(), RunError> {
        // the first rank may have begun to write
        if self.overwrite || !self.ranks.is_first() {
            return Ok(());
        }
        let checkpoints = checkpoints::list_checkpoints(&self.checkpoint_folder())?;
        if file_exists(&self.file_path(EXPERIMENT))? || !checkpoints.is_empty() {
            return Err(RunError::FolderHoldsRun { folder: self.path.clone() });
        }
        for path in FILES.iter().map(|name| self.file_path(name)) {
            if file_exists(&path)? {
                return Err(RunError::FileExists { path });
            }
        }
        Ok(())
    }

    /// Removes the files of the run in the folder, so that another can start; other files stay.
    pub(crate) fn remove_run_files(&self) -> Result<(), RunError> {
        let checkpoints = checkpoints::list_checkpoints(&self.checkpoint_folder())?;
        let sync = |folder: &Path| {
            self.disk.sync_folder(folder).map_err(RunError::write_error_mapper(folder))
        };
        // The summary first: a run that has ended is not resumed without a checkpoint. Then all
        // checkpoints, synced before anything else goes: after a power cut, none of them may be
        // taken for a checkpoint of the next run.
        self.mark_unfinished()?;
        sync(&self.path)?;
        for (_, path) in &checkpoints {
            self.remove(path)?;
        }
        if !checkpoints.is_empty() {
            sync(&self.checkpoint_folder())?;
        }
        for name in FILES.iter().chain([&EXPERIMENT]) {
            self.remove(&self.file_path(name))?;
        }
        sync(&self.path)
    }

    /// Marks the run as unfinished by removing its summary.
    pub(crate) fn mark_unfinished(&self) -> Result<(), RunError> {
        self.remove(&self.file_path(SUMMARY_FILE))
    }

    /// Removes a file if it exists.
    fn remove(&self, path: &Path) -> Result<(), RunError> {
        match self.disk.remove(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(RunError::cannot_write(path, error))
            }
            _ => Ok(()),
        }
    }

    /// Returns `true` if the folder holds a run: its settings, or a checkpoint, which has them too.
    pub fn holds_run(&self) -> bool {
        self.holds_settings() || self.holds_checkpoint()
    }

    fn holds_checkpoint(&self) -> bool {
        let checkpoints = checkpoints::list_checkpoints(&self.checkpoint_folder());
        checkpoints.is_ok_and(|there| !there.is_empty())
    }

    /// Returns `true` if the file of the settings exists.
    pub(crate) fn holds_settings(&self) -> bool {
        self.file_path(EXPERIMENT).exists()
    }

    /// Returns the error of a folder that holds no run, which names a run in a folder inside.
    pub fn no_run(&self) -> RunError {
        let entries = std::fs::read_dir(&self.path).into_iter().flatten().flatten();
        let runs = entries.map(|entry| entry.path());
        let inside = runs.filter(|path| Self::from_path(path).holds_run()).min();
        RunError::NoRun { folder: self.path.clone(), inside }
    }

    /// Returns `true` if the folder holds policies without the history of their training, as `covers
    /// pack` writes it.
    pub fn is_packed(&self) -> bool {
        // a run begins both files before its first checkpoint
        let history = ["metrics.csv", "log.txt"];
        self.holds_checkpoint() && !history.iter().any(|name| self.file_path(name).exists())
    }

    /// Returns `true` if the folder holds a run and the summary that only finished runs have.
    pub fn is_finished(&self) -> bool {
        self.holds_run() && self.file_path(SUMMARY_FILE).exists()
    }

    /// Checks the tables of a finished run against the checksums in its summary. Summaries of older
    /// versions have none and pass.
    ///
    /// # Errors
    /// [`RunError::ChangedTable`], [`RunError::Read`].
    pub fn verify_table_checksums(&self) -> Result<(), RunError> {
        /// Part of `summary.json` that holds the checksums of the run's tables.
        #[derive(Deserialize)]
        struct Checksums {
            #[serde(default)]
            tables: BTreeMap<String, String>,
        }
        let path = self.file_path(SUMMARY_FILE);
        let summary = std::fs::read(&path).map_err(RunError::read_error_mapper(&path))?;
        let summary: Checksums =
            serde_json::from_slice(&summary).map_err(RunError::read_error_mapper(&path))?;
        for name in TABLES {
            let Some(expected) = summary.tables.get(name) else { continue };
            let table_path = self.file_path(name);
            let found = match std::fs::read(&table_path) {
                Ok(table) => crc32_hex(&table),
                Err(error) if error.kind() == ErrorKind::NotFound => "missing".to_owned(),
                Err(error) => return Err(RunError::cannot_read(&table_path, error)),
            };
            if found != *expected {
                let expected = expected.clone();
                return Err(RunError::ChangedTable { path: table_path, found, expected });
            }
        }
        Ok(())
    }

    /// Checks that the robot of the run's settings, if a file describes it, is the one with which
    /// the run began. Runs of older versions pass.
    ///
    /// # Errors
    /// [`RunError::ChangedRobot`], [`RunError::Read`], errors of reading the robot.
    pub fn verify_robot(&self, settings: &Experiment) -> Result<(), RunError> {
        let embodiment = settings.envs.embodiment;
        let Some(found) = robot_checksum(embodiment)? else { return Ok(()) };
        let began_with = Provenance::read(&self.path)?.into_iter().find_map(|line| line.robot);
        match began_with.filter(|expected| *expected != found) {
            Some(expected) => {
                let (robot, folder) = (embodiment.name().into(), self.path.clone());
                Err(RunError::ChangedRobot { robot, folder, found, expected })
            }
            None => Ok(()),
        }
    }

    /// Reads the run's settings, from the newest intact checkpoint if their file is lost.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::Read`], [`RunError::NoCheckpoint`],
    /// [`learner::LearnerError::NewerFormat`].
    pub fn read_experiment(&self) -> Result<Experiment, RunError> {
        if self.holds_settings() {
            return Experiment::read(&self.file_path(EXPERIMENT));
        }
        let found = checkpoints::read_newest(&self.checkpoint_folder(), SavedRun::read)?;
        let found = found.ok_or_else(|| self.no_run())?;
        Ok(found.contents.experiment)
    }

    /// Writes the run's settings.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write_experiment(&self, experiment: &Experiment) -> Result<(), RunError> {
        let path = self.file_path(EXPERIMENT);
        let text = serde_json::to_string_pretty(experiment)
            .map_err(RunError::write_error_mapper(&path))?
            + "\n";
        self.replace_file(EXPERIMENT, text.as_bytes())
    }

    /// Returns the path of the run's folder of checkpoints.
    pub fn checkpoint_folder(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// Loads the learner of the newest checkpoint, for acting and recognition.
    ///
    /// # Errors
    /// As [`LearnerSettings::load_for_acting`], [`RunError::NoCheckpoint`],
    /// [`RunError::WithoutCheckpoints`], and [`RunError::DamagedCheckpoint`] if only an older
    /// checkpoint is intact.
    pub fn load_learner(
        &self,
        learner: &LearnerSettings,
        spec: &EnvSpec,
        labels: &TaskLabel,
    ) -> Result<Box<dyn Learner>, RunError> {
        self.load_learner_with_own_policies(learner, spec, labels).map(|loaded| loaded.0)
    }

    /// Loads the learner of the newest checkpoint, for acting and recognition, and the index
    /// of each group's own policy. A packed folder has no own policies, since it holds no tables.
    ///
    /// # Errors
    /// As [`RunFolder::load_learner`].
    pub fn load_learner_with_own_policies(
        &self,
        learner: &LearnerSettings,
        spec: &EnvSpec,
        labels: &TaskLabel,
    ) -> Result<(Box<dyn Learner>, OwnPolicyByGroup), RunError> {
        let load = |path: &Path| {
            let (learner, note) = learner.load_for_acting(path, spec, labels)?;
            if note.is_empty() {
                return Ok((learner, OwnPolicyByGroup::default()));
            }
            let mut saved = SavedRun::parse(path, &note)?;
            saved.recount_rollouts(path)?;
            Ok((learner, saved.state.stats.own_policies()))
        };
        let found = checkpoints::read_newest(&self.checkpoint_folder(), load)?;
        let none = || RunError::WithoutCheckpoints { folder: self.path.clone() };
        let found = found.ok_or_else(none)?;
        if !found.problems.is_empty() {
            return Err(RunError::DamagedCheckpoint {
                folder: self.path.clone(),
                problems: found.problems.join("; "),
                intact: found.path,
            });
        }
        Ok(found.contents)
    }

    /// Creates the folder `path`, which must not exist yet, with a run's settings and one
    /// checkpoint of `learner`, for evaluation and deployment.
    ///
    /// # Errors
    /// As [`Learner::save`]; nothing is created if the learner cannot be saved.
    pub fn create_with_learner(
        path: &Path,
        experiment: &Experiment,
        learner: &dyn Learner,
        extent: CheckpointExtent,
    ) -> Result<Self, RunError> {
        let folder = Self::from_path(path);
        let checkpoint = checkpoints::checkpoint_path(&folder.checkpoint_folder(), 0);
        let bytes = learner.to_checkpoint_bytes(&checkpoint, extent, "")?;
        create_dir(path).map_err(RunError::write_error_mapper(path))?;
        folder.prepare_for_run()?;
        folder.write_experiment(experiment)?;
        write_atomically(folder.disk(), &checkpoint, &bytes)?;
        Ok(folder)
    }

    pub(crate) fn disk(&self) -> &dyn Disk {
        &*self.disk
    }

    pub(crate) fn shared_disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.disk)
    }

    /// Returns the path of the file called `name` in the run's folder.
    pub fn file_path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes the file called `name` in the run's folder atomically.
    pub(crate) fn replace_file(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        Ok(write_atomically(self.disk(), &self.file_path(name), bytes)?)
    }

    /// Appends a line to the file called `name` in the run's folder; the next checkpoint syncs it.
    pub(crate) fn append_line(&self, name: &str, line: &str) -> Result<(), RunError> {
        let path = self.file_path(name);
        let contents = std::fs::read(&path).unwrap_or_default();
        // a line torn by a full disk or a power cut must not swallow the next one
        let torn = contents.last().is_some_and(|&last| last != b'\n');
        let line = format!("{}{line}\n", if torn { "\n" } else { "" });
        self.disk.append(&path, line.as_bytes()).map_err(RunError::write_error_mapper(&path))
    }

    /// Appends the provenance of a process that works on the run to `provenance.jsonl`.
    pub(crate) fn record_provenance(&self, provenance: &Provenance) -> Result<(), RunError> {
        let line =
            serde_json::to_string(provenance).map_err(RunError::write_error_mapper(&self.path))?;
        self.append_line(Provenance::FILE_NAME, &line)
    }

    /// Syncs the named files of the run's folder to the disk; files that do not exist are skipped.
    pub(crate) fn sync_files(&self, names: &[&str]) -> Result<(), RunError> {
        for path in names.iter().map(|name| self.file_path(name)) {
            match self.disk.sync(&path) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    return Err(RunError::cannot_write(&path, error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Creates the folder of checkpoints and removes partial files of interrupted writes.
    pub(crate) fn prepare_for_run(&self) -> Result<(), RunError> {
        if !self.ranks.is_first() {
            return Ok(());
        }
        let (path, parent) = (self.checkpoint_folder(), parent_folder(&self.path));
        let write = |error| RunError::cannot_write(&path, error);
        match self.disk.create_folder(&path) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(write(error)),
            _ => self.disk.sync_folder(&self.path).map_err(write)?,
        }
        // the folder and its parent may be new, and a new folder is durable only once the folder
        // that contains it is synced
        for folder in [parent, parent_folder(parent)] {
            match self.disk.sync_folder(folder) {
                // a folder of another user, which this process cannot have created
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {}
                other => other.map_err(write)?,
            }
        }
        for folder in [&path, &self.path] {
            for entry in read_dir(folder).map_err(write)? {
                let entry = entry.map_err(write)?.path();
                if entry.extension().is_some_and(|extension| extension == PARTIAL_FILE_EXTENSION) {
                    self.disk.remove(&entry).map_err(write)?;
                }
            }
        }
        Ok(())
    }

    /// Writes an image as the PNG file called `name` in the run's folder.
    pub(crate) fn write_png(&self, name: &str, picture: &Picture) -> Result<(), RunError> {
        let bytes =
            picture.to_png().map_err(RunError::write_error_mapper(&self.file_path(name)))?;
        self.replace_file(name, &bytes)
    }
}

//! The folder of one run: settings as JSON, tables as CSV, pictures as PNG, the learner as
//! safetensors.

use std::collections::BTreeMap;
use std::fs::{create_dir, create_dir_all};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rl::EnvSpec;
use serde::Deserialize;

use crate::error::RunError;
use crate::evaluation::OwnPolicies;
use crate::experiment::Experiment;
use crate::sheet::Picture;
use learner::disk::{Disk, LocalDisk, PARTIAL, folder_of, replace};
use learner::{Extent, Labels, Learner, LearnerSettings};

use super::checkpoints;
use crate::lock::Lock;
use crate::note::Signed;
use crate::provenance::Provenance;
use crate::table::put_aside;

/// The file of a run's settings.
const EXPERIMENT: &str = "experiment.json";
/// The file that a finished run leaves.
pub const SUMMARY: &str = "summary.json";
/// Table of times, the only one that no checkpoint holds.
pub(crate) const TIMINGS: &str = "timings.csv";
/// Tables of a run.
const TABLES: [&str; 5] =
    ["evaluation.csv", "metrics.csv", "recognition.csv", TIMINGS, "units.csv"];
/// The files of a run beside its settings and checkpoints.
const FILES: [&str; 9] = [
    "contact_sheet.png",
    "evaluation.csv",
    "log.txt",
    "metrics.csv",
    "provenance.jsonl",
    "recognition.csv",
    SUMMARY,
    "timings.csv",
    "units.csv",
];

/// CRC-32 (IEEE 802.3) of a table as eight hexadecimal digits.
pub(crate) fn checksum(table: &[u8]) -> String {
    format!("{:08x}", crc32fast::hash(table))
}

/// A folder that one run alone writes to.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// File system that changes of the folder go through.
    disk: Arc<dyn Disk>,
    /// File system below the fence of a run; the same where no run has the folder.
    unfenced: Arc<dyn Disk>,
    overwrite: bool,
}

impl RunFolder {
    /// Creates `parent/name`, or `parent/name-2`, `-3`, ... where that exists: no run overwrites
    /// another.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn create(parent: &Path, name: &str) -> Result<Self, RunError> {
        create_dir_all(parent).map_err(|error| RunError::write(parent, error))?;
        let mut attempt = 1;
        loop {
            let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
            let path = parent.join(format!("{name}{suffix}"));
            match create_dir(&path) {
                Ok(()) => return Ok(Self::open(&path)),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => attempt += 1,
                Err(error) => return Err(RunError::write(&path, error)),
            }
        }
    }

    /// Where the folder is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names a folder that an earlier run wrote.
    pub fn open(path: &Path) -> Self {
        let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
        Self { path: path.to_owned(), unfenced: Arc::clone(&disk), disk, overwrite: false }
    }

    /// The same folder, changed by way of `disk`.
    pub fn with_disk(mut self, disk: Arc<dyn Disk>) -> Self {
        self.unfenced = Arc::clone(&disk);
        self.disk = disk;
        self
    }

    /// Takes the right to write to the folder, and returns it with the folder as the holder of that
    /// right: all its changes fail once another process has taken the run over.
    ///
    /// # Errors
    /// [`RunError::Locked`], [`RunError::Write`].
    pub(crate) fn lock(mut self) -> Result<(Self, Lock), RunError> {
        let lock = Lock::take(&self.path)?;
        self.disk = Arc::new(lock.fence(Arc::clone(&self.unfenced)));
        Ok((self, lock))
    }

    /// The same folder, in which a run may begin even where it holds another, whose files are then
    /// removed.
    pub fn overwriting(mut self) -> Self {
        self.overwrite = true;
        self
    }

    /// Whether a run may begin here.
    pub(crate) fn is_free(&self) -> Result<bool, RunError> {
        let checkpoints = checkpoints::list(&self.checkpoints())?;
        Ok(self.overwrite || !self.holds_settings() && checkpoints.is_empty())
    }

    /// Removes the files of the run that is there, so that another can begin; other files stay. Its
    /// checkpoints go first and for good: none may be taken for one of the next run.
    pub(crate) fn clear(&self) -> Result<(), RunError> {
        let checkpoints = checkpoints::list(&self.checkpoints())?;
        let sync = |folder: &Path| {
            let synced = self.disk.sync_folder(folder);
            synced.map_err(|error| RunError::write(folder, error))
        };
        for (_, path) in &checkpoints {
            self.remove(path)?;
        }
        if !checkpoints.is_empty() {
            sync(&self.checkpoints())?;
        }
        for name in FILES.iter().chain([&EXPERIMENT]) {
            self.remove(&self.file(name))?;
        }
        sync(&self.path)
    }

    /// Says that the run is not at its end, whatever was there before.
    pub(crate) fn reopen(&self) -> Result<(), RunError> {
        self.remove(&self.file(SUMMARY))
    }

    /// Removes a file, where there is one.
    fn remove(&self, path: &Path) -> Result<(), RunError> {
        match self.disk.remove(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(RunError::write(path, error)),
            _ => Ok(()),
        }
    }

    /// Whether a run began here: its settings are there, or a checkpoint, which holds them, too.
    pub fn holds_run(&self) -> bool {
        let checkpoints = || checkpoints::list(&self.checkpoints());
        self.holds_settings() || checkpoints().is_ok_and(|there| !there.is_empty())
    }

    /// Whether the file of the settings is there.
    pub(crate) fn holds_settings(&self) -> bool {
        self.file(EXPERIMENT).exists()
    }

    /// Whether the run that began here ended.
    pub fn is_finished(&self) -> bool {
        self.holds_run() && self.file(SUMMARY).exists()
    }

    /// Checks the tables of a finished run against the checksums in its summary. Summaries of older
    /// versions have none and pass.
    ///
    /// # Errors
    /// [`RunError::ChangedTable`], [`RunError::Read`].
    pub fn verify_tables(&self) -> Result<(), RunError> {
        TABLES.iter().try_for_each(|name| self.verify_table(name))
    }

    fn verify_table(&self, name: &str) -> Result<(), RunError> {
        /// Part of a summary.
        #[derive(Deserialize)]
        struct Checksums {
            #[serde(default)]
            tables: BTreeMap<String, String>,
        }
        let path = self.file(SUMMARY);
        let summary = std::fs::read(&path).map_err(|error| RunError::read(&path, error))?;
        let summary: Checksums =
            serde_json::from_slice(&summary).map_err(|error| RunError::read(&path, error))?;
        let Some(expected) = summary.tables.get(name) else {
            return Ok(());
        };
        let path = self.file(name);
        let found = match std::fs::read(&path) {
            Ok(table) => checksum(&table),
            Err(error) if error.kind() == ErrorKind::NotFound => "missing".to_owned(),
            Err(error) => return Err(RunError::read(&path, error)),
        };
        if found == *expected {
            return Ok(());
        }
        let expected = expected.clone();
        Err(RunError::ChangedTable { path, found, expected })
    }

    /// Puts the timings of a finished run aside if they were changed: no checkpoint can restore
    /// them, and times that are unknown are better than times that somebody edited.
    ///
    /// # Errors
    /// [`RunError::Read`], [`RunError::Write`].
    pub(crate) fn drop_changed_timings(&self) -> Result<(), RunError> {
        let path = self.file(TIMINGS);
        match self.verify_table(TIMINGS) {
            Err(RunError::ChangedTable { .. }) if path.exists() => put_aside(self.disk(), &path),
            Err(RunError::ChangedTable { .. }) | Ok(()) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Reads the run's settings; where their file is lost, from the newest intact checkpoint.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::Read`], [`RunError::NoCheckpoint`],
    /// [`learner::LearnerError::NewerFormat`].
    pub fn experiment(&self) -> Result<Experiment, RunError> {
        if self.holds_settings() {
            return Experiment::read(&self.file(EXPERIMENT));
        }
        let found = checkpoints::newest(&self.checkpoints(), Signed::read)?;
        let found = found.ok_or_else(|| RunError::NoRun { folder: self.path.clone() })?;
        Ok(found.value.experiment)
    }

    /// Writes the run's settings.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write_experiment(&self, experiment: &Experiment) -> Result<(), RunError> {
        let path = self.file(EXPERIMENT);
        let text = serde_json::to_string_pretty(experiment);
        let text = text.map_err(|error| RunError::write(&path, error))? + "\n";
        self.replace(EXPERIMENT, text.as_bytes())
    }

    /// The folder of checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// The learner of the newest intact checkpoint, for acting and recognising.
    ///
    /// # Errors
    /// As [`LearnerSettings::load`], and [`RunError::NoCheckpoint`].
    pub fn load_learner(
        &self,
        learner: &LearnerSettings,
        spec: &EnvSpec,
        labels: &Labels,
    ) -> Result<Box<dyn Learner>, RunError> {
        self.load_with_policies(learner, spec, labels).map(|loaded| loaded.0)
    }

    /// The learner of the newest intact checkpoint, and the own policies of groups; none of a
    /// packed folder, which has no books.
    ///
    /// # Errors
    /// As [`RunFolder::load_learner`].
    pub fn load_with_policies(
        &self,
        learner: &LearnerSettings,
        spec: &EnvSpec,
        labels: &Labels,
    ) -> Result<(Box<dyn Learner>, OwnPolicies), RunError> {
        let load = |path: &Path| {
            let (learner, note) = learner.load(path, spec, labels)?;
            if note.is_empty() {
                return Ok((learner, OwnPolicies::default()));
            }
            let mut signed = Signed::parse(path, &note)?;
            signed.recount(path)?;
            Ok((learner, signed.note.ledger.own_policies()))
        };
        let found = checkpoints::newest(&self.checkpoints(), load)?;
        let none = || RunError::NoCheckpoint {
            folder: self.path.clone(),
            problems: "there is none yet".to_owned(),
        };
        found.map(|found| found.value).ok_or_else(none)
    }

    /// Creates a folder with settings and one checkpoint, which no run works on. Nothing is created
    /// where the learner cannot be saved.
    ///
    /// # Errors
    /// As [`Learner::save`].
    pub fn pack(
        path: &Path,
        experiment: &Experiment,
        learner: &dyn Learner,
        extent: Extent,
    ) -> Result<Self, RunError> {
        let folder = Self::open(path);
        let checkpoint = checkpoints::path(&folder.checkpoints(), 0);
        let bytes = learner.encode(&checkpoint, extent, "")?;
        create_dir(path).map_err(|error| RunError::write(path, error))?;
        folder.prepare()?;
        folder.write_experiment(experiment)?;
        replace(folder.disk(), &checkpoint, &bytes)?;
        Ok(folder)
    }

    pub(crate) fn disk(&self) -> &dyn Disk {
        &*self.disk
    }

    pub(crate) fn shared_disk(&self) -> Arc<dyn Disk> {
        Arc::clone(&self.disk)
    }

    /// A file of the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file; it appears whole or not at all.
    pub(crate) fn replace(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        Ok(replace(self.disk(), &self.file(name), bytes)?)
    }

    /// Adds a line to a file. It comes to the disk with the next checkpoint.
    pub(crate) fn append(&self, name: &str, line: &str) -> Result<(), RunError> {
        let path = self.file(name);
        let there = std::fs::read(&path).unwrap_or_default();
        // a line that was torn by a full disk or a power cut stays alone
        let torn = there.last().is_some_and(|&last| last != b'\n');
        let line = format!("{}{line}\n", if torn { "\n" } else { "" });
        let added = self.disk.append(&path, line.as_bytes());
        added.map_err(|error| RunError::write(&path, error))
    }

    /// Notes a process that works on the run.
    pub(crate) fn sign(&self, provenance: &Provenance) -> Result<(), RunError> {
        let line = serde_json::to_string(provenance);
        let line = line.map_err(|error| RunError::write(&self.path, error))?;
        self.append(Provenance::FILE, &line)
    }

    /// Brings files to the disk, those that are there.
    pub(crate) fn sync(&self, names: &[&str]) -> Result<(), RunError> {
        for path in names.iter().map(|name| self.file(name)) {
            match self.disk.sync(&path) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    return Err(RunError::write(&path, error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Makes the folder of checkpoints and removes what a process left there that was interrupted
    /// while it wrote.
    pub(crate) fn prepare(&self) -> Result<(), RunError> {
        let (path, parent) = (self.checkpoints(), folder_of(&self.path));
        let write = |error| RunError::write(&path, error);
        match self.disk.create_folder(&path) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(write(error)),
            _ => self.disk.sync_folder(&self.path).map_err(write)?,
        }
        // the folder may be new, and so may the one that it is in
        for folder in [parent, folder_of(parent)] {
            match self.disk.sync_folder(folder) {
                // somebody else's, who lets nobody list it: it is not new
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {}
                other => other.map_err(write)?,
            }
        }
        for folder in [&path, &self.path] {
            for entry in std::fs::read_dir(folder).map_err(write)? {
                let entry = entry.map_err(write)?.path();
                if entry.extension().is_some_and(|ending| ending == PARTIAL) {
                    self.disk.remove(&entry).map_err(write)?;
                }
            }
        }
        Ok(())
    }

    /// Writes a picture.
    pub(crate) fn write_png(&self, name: &str, picture: &Picture) -> Result<(), RunError> {
        let bytes = picture.to_png();
        let bytes = bytes.map_err(|error| RunError::write(&self.file(name), error))?;
        self.replace(name, &bytes)
    }
}

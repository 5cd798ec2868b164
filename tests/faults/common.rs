//! Small runs, what of their files must be equal, and disks that are watched.

use std::fmt::{self, Debug};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use covers::presets::Method;
use covers::{Disk, Experiment, LocalDisk, Run, RunFolder};

use crate::runs::two_groups;
pub use crate::runs::{Bytes, TABLES, bytes, checkpoints, crash_after, newest};
pub use crate::scratch::Scratch;

impl Scratch {
    pub fn run(&self, name: &str) -> RunFolder {
        RunFolder::create(&self.0, name).unwrap()
    }
}

/// Whether the whole programme runs, and not the short one of the test suite.
pub fn full() -> bool {
    std::env::var("COVERS_FAULTS").is_ok_and(|value| value == "full")
}

/// Two groups, few environments, a checkpoint after every rollout, and nothing asked after the
/// stream but scores.
///
/// COVERS learns from two rollouts of the first group; the third turn hands over to a second policy
/// and takes three, and two more are left.
pub fn tiny(method: Method) -> Experiment {
    let mut experiment = two_groups(method).with_threads(2);
    // this seed shuffles them: the second comes first
    experiment.schedule.groups[0].decisions = 5 * 80;
    experiment.schedule.groups[1].decisions = 2 * 80;
    experiment.checkpoints.every = 1;
    experiment.envs.num_envs = 4;
    experiment.evaluation.recognition_repeats = 0;
    experiment
}

pub fn finish(mut run: Run) -> Bytes {
    while run.advance().unwrap().is_some() {}
    assert!(run.is_finished());
    bytes(run.folder().path())
}

/// What a run that nothing happens to writes.
pub fn reference(experiment: &Experiment) -> Bytes {
    let scratch = Scratch::new("reference");
    finish(Run::start(experiment.clone(), scratch.run("run")).unwrap())
}

/// A run of [`tiny`] after its first rollout, and its folder.
pub fn begun(scratch: &Scratch) -> (Run, PathBuf) {
    let mut run = Run::start(tiny(Method::Covers), scratch.run("run")).unwrap();
    run.advance().unwrap();
    let folder = run.folder().path().to_owned();
    (run, folder)
}

/// What [`tiny`] writes with COVERS.
pub fn expected() -> &'static Bytes {
    static EXPECTED: OnceLock<Bytes> = OnceLock::new();
    EXPECTED.get_or_init(|| reference(&tiny(Method::Covers)))
}

/// The folder of a run of [`tiny`] that was dropped after three rollouts of five: checkpoints after
/// 1, 2 and 3 of them, and two policies in the last. It is a copy: one run serves all tests.
pub fn interrupted(scratch: &Scratch) -> PathBuf {
    static FILES: OnceLock<Bytes> = OnceLock::new();
    let files = FILES.get_or_init(|| {
        let inner = Scratch::new("interrupted");
        let run = Run::start(tiny(Method::Covers), inner.run("run")).unwrap();
        contents(&crash_after(3, run))
    });
    let folder = scratch.run("run").path().to_owned();
    fs::create_dir(folder.join("checkpoints")).unwrap();
    for (file, bytes) in files {
        fs::write(folder.join(file), bytes).unwrap();
    }
    assert_eq!(checkpoints(&folder).len(), 3);
    folder
}

pub fn contents(folder: &Path) -> Bytes {
    let inside = [folder.to_owned(), folder.join("checkpoints")];
    let entries = inside.iter().flat_map(|path| fs::read_dir(path).unwrap());
    let paths = entries.map(|entry| entry.unwrap().path());
    let files = paths.filter(|path| path.is_file());
    let read = |path: PathBuf| {
        let bytes = fs::read(&path).unwrap();
        (path.strip_prefix(folder).unwrap().to_owned(), bytes)
    };
    files.map(read).collect()
}

pub fn assert_same(got: &Bytes, expected: &Bytes) {
    for (file, bytes) in expected {
        assert!(got.get(file) == Some(bytes), "{} differs", file.display());
    }
}

#[derive(Clone, Debug)]
pub enum Operation {
    Write(PathBuf, Vec<u8>),
    Append(PathBuf, Vec<u8>),
    Sync(PathBuf),
    Rename(PathBuf, PathBuf),
    Remove(PathBuf),
    CreateFolder(PathBuf),
    SyncFolder(PathBuf),
    /// No operation: from here on the checkpoint after this many rollouts must not be lost.
    Promise(usize),
}

/// The real disk; a function sees every operation before it happens, and may refuse it.
pub struct Watched<F>(pub F);

impl<F> Debug for Watched<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Watched")
    }
}

impl<F: Fn(&Operation) -> io::Result<()> + Send + Sync> Disk for Watched<F> {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.0(&Operation::Write(path.to_owned(), bytes.to_vec()))?;
        LocalDisk.write(path, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.0(&Operation::Append(path.to_owned(), bytes.to_vec()))?;
        LocalDisk.append(path, bytes)
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        self.0(&Operation::Sync(path.to_owned()))?;
        LocalDisk.sync(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.0(&Operation::Rename(from.to_owned(), to.to_owned()))?;
        LocalDisk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.0(&Operation::Remove(path.to_owned()))?;
        LocalDisk.remove(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.0(&Operation::CreateFolder(path.to_owned()))?;
        LocalDisk.create_folder(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.0(&Operation::SyncFolder(path.to_owned()))?;
        LocalDisk.sync_folder(path)
    }
}

//! What a run asks of the file system: few operations, so that tests can fail any of them and
//! replay a power cut between any two.

use std::fmt::Debug;
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::error::LearnerError;

/// The operations by which a run changes its folder.
///
/// The rules are those of POSIX. Bytes of [`write`](Disk::write) and [`append`](Disk::append)
/// survive a power cut once [`sync`](Disk::sync) was called. Names survive once
/// [`sync_folder`](Disk::sync_folder) was called on their folder.
pub trait Disk: Debug + Send + Sync {
    /// Creates a file or empties it, and writes `bytes`.
    ///
    /// # Errors
    /// Errors of the file system.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Adds bytes to the end of a file, which is created where it does not exist.
    ///
    /// # Errors
    /// Errors of the file system.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Brings the bytes of a file to the disk.
    ///
    /// # Errors
    /// Errors of the file system.
    fn sync(&self, path: &Path) -> io::Result<()>;

    /// Gives a file another name; a file of that name is replaced.
    ///
    /// # Errors
    /// Errors of the file system.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file.
    ///
    /// # Errors
    /// Errors of the file system.
    fn remove(&self, path: &Path) -> io::Result<()>;

    /// Creates a folder; its parent must exist.
    ///
    /// # Errors
    /// Errors of the file system.
    fn create_folder(&self, path: &Path) -> io::Result<()>;

    /// Brings the names in a folder to the disk.
    ///
    /// # Errors
    /// Errors of the file system.
    fn sync_folder(&self, path: &Path) -> io::Result<()>;
}

/// The file system of this machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct LocalDisk;

impl Disk for LocalDisk {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        fs::write(path, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut file = OpenOptions::new().append(true).create(true).open(path)?;
        file.write_all(bytes)
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }
}

/// The ending of files that are not whole yet.
pub const PARTIAL: &str = "partial";

/// Puts a file in the place of `path`: it appears whole or not at all, also after a power cut.
///
/// # Errors
/// [`LearnerError::Write`]; the old file is then still there.
pub fn replace(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> Result<(), LearnerError> {
    let partial = partial_name(path);
    let written = disk
        .write(&partial, bytes)
        .and_then(|()| disk.sync(&partial))
        .and_then(|()| disk.rename(&partial, path))
        .and_then(|()| disk.sync_folder(folder_of(path)));
    if written.is_err() {
        // a full disk needs the room; that this fails, too, is no news
        let _ = disk.remove(&partial);
    }
    written.map_err(|error| LearnerError::write(path, error))
}

/// Name of a file that becomes `path` when it is whole. Each process has names of its own, since two
/// machines may hold the same folder's lock where a file server does not share locks.
fn partial_name(path: &Path) -> PathBuf {
    static PROCESS: LazyLock<u64> = LazyLock::new(random_number);
    path.with_added_extension(format!("{:016x}.{PARTIAL}", *PROCESS))
}

/// Random number from the system, not from any seed.
pub fn random_number() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// Sees whether [`replace`] could write `path`, and leaves everything as it is.
///
/// # Errors
/// [`LearnerError::Write`].
pub fn try_out(disk: &dyn Disk, path: &Path) -> Result<(), LearnerError> {
    let partial = partial_name(path);
    let tried = match path.is_dir() {
        true => Err(std::io::ErrorKind::IsADirectory.into()),
        false => disk.write(&partial, &[]),
    };
    let tried = tried.and_then(|()| disk.remove(&partial));
    tried.map_err(|error| LearnerError::write(path, error))
}

/// The folder that a file or a folder is in.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

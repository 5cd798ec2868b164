//! File operations of a run: few, so that tests can fail any of them and replay a power cut between
//! any two.

use std::fmt::Debug;
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::error::LearnerError;

/// File operations by which a run changes its folder, so that tests can make any of them fail.
///
/// The guarantees are those of POSIX. Bytes of [`write`](Disk::write) and [`append`](Disk::append)
/// survive a power cut once [`sync`](Disk::sync) was called. Names survive once
/// [`sync_folder`](Disk::sync_folder) was called on their folder. All methods return the errors of
/// the file system.
pub trait Disk: Debug + Send + Sync {
    /// Creates a file or empties it, and writes `bytes`.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Appends bytes to a file, which is created if it does not exist.
    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Flushes the bytes of a file to the storage device.
    fn sync(&self, path: &Path) -> io::Result<()>;

    /// Renames a file and replaces an existing file of that name.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;

    /// Creates a folder; its parent must exist.
    fn create_folder(&self, path: &Path) -> io::Result<()>;

    /// Flushes the names in a folder to the storage device.
    fn sync_folder(&self, path: &Path) -> io::Result<()>;
}

/// Disk operations on the file system of this machine.
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

/// Disk that changes nothing, for all processes of a run but the one that writes its files.
#[derive(Clone, Copy, Debug)]
pub struct NoDisk;

impl Disk for NoDisk {
    fn write(&self, _: &Path, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn append(&self, _: &Path, _: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn sync(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn rename(&self, _: &Path, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn remove(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn create_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn sync_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }
}

/// Extension of the names of temporary files, which are renamed once they are written in full.
pub const PARTIAL_FILE_EXTENSION: &str = "partial";

/// Replaces the file at `path` atomically: the new file appears whole or not at all, also after a
/// power cut.
///
/// # Errors
/// [`LearnerError::Write`]; the old file is then still there.
pub fn write_atomically(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> Result<(), LearnerError> {
    let partial = partial_name(path);
    // bytes must reach the disk before the new name does, or a power cut could leave an empty file
    let written = disk
        .write(&partial, bytes)
        .and_then(|()| disk.sync(&partial))
        .and_then(|()| disk.rename(&partial, path))
        .and_then(|()| disk.sync_folder(parent_folder(path)));
    if written.is_err() {
        // frees the room on a full disk; an error here would only repeat the first one
        let _ = disk.remove(&partial);
    }
    written.map_err(|error| LearnerError::cannot_write(path, error))
}

/// Returns the temporary name of a file that is renamed to `path` once it is written. Each process
/// has its own names, since two machines may hold one folder's lock if a file server does not share
/// locks.
fn partial_name(path: &Path) -> PathBuf {
    static PROCESS: LazyLock<u64> = LazyLock::new(os_random_u64);
    path.with_added_extension(format!("{:016x}.{PARTIAL_FILE_EXTENSION}", *PROCESS))
}

/// Returns a random number from the operating system, independent of the seeds of runs.
pub fn os_random_u64() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// Checks that [`write_atomically`] could write `path`: creates and removes an empty file beside
/// it.
///
/// # Errors
/// [`LearnerError::Write`].
pub fn check_path_writable(disk: &dyn Disk, path: &Path) -> Result<(), LearnerError> {
    let partial = partial_name(path);
    let tried = if path.is_dir() {
        Err(io::ErrorKind::IsADirectory.into())
    } else {
        disk.write(&partial, &[])
    };
    let tried = tried.and_then(|()| disk.remove(&partial));
    tried.map_err(|error| LearnerError::cannot_write(path, error))
}

/// Returns the parent folder of a file or folder; `.` for a name alone.
pub fn parent_folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

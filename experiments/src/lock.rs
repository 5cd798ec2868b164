//! Lock for a run's folder, and a file system that stops a writer that lost the folder.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::error::{RunError, TakenOver};
use crate::provenance::command_line;
use learner::disk::{Disk, os_random_u64};

/// Name of the file that the writer of a folder locks. It is never read, since some file servers
/// let no other handle read a locked file.
pub(crate) const LOCK: &str = "lock";
/// Time after which a shared lock of [`is_locked`] is gone.
const SHARED_LOCK_TIME: Duration = Duration::from_millis(50);
/// Name of the file that says which process took the lock last.
const OWNER: &str = "owner";

/// Exclusive right to write to a folder. The operating system releases it when the process ends,
/// also after a crash.
#[derive(Debug)]
pub(crate) struct FolderLock {
    _file: File,
    claim: Claim,
}

/// Identity of the process that holds a folder's lock, as the owner file in the folder states it.
#[derive(Clone, Debug)]
struct Claim {
    folder: PathBuf,
    /// Text that names this process and ends with a random number.
    owner: String,
}

impl FolderLock {
    /// Locks `folder` for writing and stores this process's name there.
    ///
    /// # Errors
    /// [`RunError::Locked`] with the name of the process that holds the lock; [`RunError::Write`].
    pub fn acquire(folder: &Path) -> Result<Self, RunError> {
        let path = folder.join(LOCK);
        let write = |error| RunError::cannot_write(&path, error);
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let file = options.open(&path).map_err(write)?;
        let locked = file.try_lock().or_else(|_| {
            // `is_locked` of another process holds a shared lock for a moment
            std::thread::sleep(SHARED_LOCK_TIME);
            file.try_lock()
        });
        match locked {
            Ok(()) => {}
            Err(TryLockError::Error(error)) => return Err(write(error)),
            Err(TryLockError::WouldBlock) => {
                return Err(RunError::Locked {
                    folder: folder.to_owned(),
                    holder: first_line(&fs::read_to_string(folder.join(OWNER)).unwrap_or_default()),
                });
            }
        }
        let owner = owner();
        let owner_path = folder.join(OWNER);
        fs::write(&owner_path, &owner).map_err(RunError::write_error_mapper(&owner_path))?;
        let folder = folder.to_owned();
        let claim = Claim { folder, owner };
        Ok(Self { _file: file, claim })
    }

    /// Wraps `disk` so that every change first checks that this lock still owns the folder.
    /// Dropping the lock releases it, also while the returned file system is in use.
    pub fn fenced_disk(&self, disk: Arc<dyn Disk>) -> FencedDisk {
        let claim = self.claim.clone();
        FencedDisk { disk, claim }
    }
}

impl Claim {
    /// Checks that no other process has taken the folder over since.
    ///
    /// The operating system's lock is not enough: a file server that lost a client grants its lock
    /// to another client, and a moved folder takes the locked file along.
    ///
    /// # Errors
    /// [`TakenOver`], which [`RunError::cannot_write`] turns into [`RunError::TakenOver`].
    fn verify(&self) -> io::Result<()> {
        let holder = match fs::read_to_string(self.folder.join(OWNER)) {
            Ok(owner) if owner == self.owner => return Ok(()),
            Ok(owner) => Some(first_line(&owner)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let folder = self.folder.clone();
        Err(io::Error::other(TakenOver { folder, holder }))
    }
}

/// Returns `true` if a process holds the lock of a folder; `None` if that cannot be found out.
pub(crate) fn is_locked(folder: &Path) -> Option<bool> {
    match File::open(folder.join(LOCK)).ok()?.try_lock_shared() {
        Ok(()) => Some(false),
        Err(TryLockError::WouldBlock) => Some(true),
        Err(TryLockError::Error(_)) => None,
    }
}

/// Returns the text of the owner file: the name of this process and a random number that tells its
/// locks apart.
fn owner() -> String {
    let system = |name: &str| {
        let text = fs::read_to_string(Path::new("/proc/sys/kernel").join(name));
        text.map_or_else(|_| "unknown".to_owned(), |text| text.trim().to_owned())
    };
    format!(
        "process {} on {}, `{}`\nboot {}\nclaim {:016x}\n",
        std::process::id(),
        system("hostname"),
        command_line().join(" "),
        system("random/boot_id"),
        os_random_u64()
    )
}

/// Returns the first line of an owner file, which names the process.
fn first_line(owner: &str) -> String {
    match owner.lines().next() {
        Some(name) => name.to_owned(),
        // the process holds the lock but has not written its name yet
        None => "a process that has just begun".to_owned(),
    }
}

/// File system that rejects every change once another process has taken the folder over.
///
/// A process can be frozen for longer than its lock lasts, by a suspended machine or a network that
/// is down. When it continues, another one may have finished the run, and stale rows must not
/// replace newer ones.
#[derive(Debug)]
pub(crate) struct FencedDisk {
    disk: Arc<dyn Disk>,
    claim: Claim,
}

impl Disk for FencedDisk {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.write(path, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.append(path, bytes)
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.sync(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.remove(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.create_folder(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.claim.verify()?;
        self.disk.sync_folder(path)
    }
}

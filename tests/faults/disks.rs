//! Disks that are full or read-only at any operation of a run.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use covers::presets::Method;
use covers::{CoversError, Disk, LocalDisk, Run, RunFolder};

use crate::common::{Scratch, assert_same, expected, finish, full, tiny};

/// A disk whose operations fail from the nth on; a write that fails leaves half of its bytes.
#[derive(Debug)]
struct Failing {
    after: usize,
    done: AtomicUsize,
    reason: ErrorKind,
}

impl Failing {
    fn new(after: usize, reason: ErrorKind) -> Arc<Self> {
        let done = AtomicUsize::new(0);
        Arc::new(Self {
            after,
            done,
            reason,
        })
    }

    fn next(&self) -> io::Result<()> {
        if self.done.fetch_add(1, Ordering::Relaxed) < self.after {
            return Ok(());
        }
        Err(self.reason.into())
    }

    fn halved(&self, bytes: &[u8], write: impl Fn(&[u8]) -> io::Result<()>) -> io::Result<()> {
        match self.next() {
            Ok(()) => write(bytes),
            Err(error) => write(&bytes[..bytes.len() / 2]).and(Err(error)),
        }
    }
}

impl Disk for Failing {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.halved(bytes, |bytes| LocalDisk.write(path, bytes))
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.halved(bytes, |bytes| LocalDisk.append(path, bytes))
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        self.next().and_then(|()| LocalDisk.sync(path))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.next().and_then(|()| LocalDisk.rename(from, to))
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.next().and_then(|()| LocalDisk.remove(path))
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.next().and_then(|()| LocalDisk.create_folder(path))
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.next().and_then(|()| LocalDisk.sync_folder(path))
    }
}

/// Runs until the disk fails; the error must name a file of the folder.
fn run_until_failure(folder: &RunFolder, disk: Arc<Failing>) -> Option<CoversError> {
    let experiment = tiny(Method::Covers);
    let mut run = match Run::start(experiment, folder.clone().with_disk(disk)) {
        Ok(run) => run,
        Err(error) => return Some(error),
    };
    loop {
        match run.advance() {
            Ok(Some(_)) => {}
            Ok(None) => return None,
            Err(error) => {
                let again = run.advance().err().unwrap();
                assert!(matches!(again, CoversError::Broken), "{again}");
                return Some(error);
            }
        }
    }
}

#[test]
fn a_disk_that_fails_at_any_operation_costs_nothing_but_time() {
    let scratch = Scratch::new("failing");
    let expected = expected();
    let operations = Failing::new(usize::MAX, ErrorKind::Other);
    assert!(run_until_failure(&scratch.run("whole"), Arc::clone(&operations)).is_none());
    let operations = operations.done.load(Ordering::Relaxed);
    let step = if full() { 1 } else { operations / 4 };
    for after in (0..operations).step_by(step) {
        let reason = [ErrorKind::StorageFull, ErrorKind::ReadOnlyFilesystem][after % 2];
        let folder = scratch.run("run");
        let disk = Failing::new(after, reason);
        let error = run_until_failure(&folder, disk).unwrap();
        let message = error.to_string();
        assert!(matches!(error, CoversError::Write { .. }), "{message}");
        assert!(
            message.contains(folder.path().to_str().unwrap()),
            "{message}"
        );
        let run = if folder.holds_run() {
            Run::resume(folder.path(), Some(1)).unwrap()
        } else {
            Run::start(tiny(Method::Covers), folder).unwrap()
        };
        assert_same(&finish(run), expected);
    }
    println!(
        "{} of {operations} operations failed",
        operations.div_ceil(step)
    );
}

/// `/dev/full` is a disk without room.
#[test]
fn a_full_disk_is_named_and_leaves_the_last_checkpoint() {
    let scratch = Scratch::new("full");
    let experiment = tiny(Method::Covers);
    let mut run = Run::start(experiment, scratch.run("run")).unwrap();
    run.advance().unwrap();
    let folder = run.folder().path().to_owned();
    let next = folder.join("checkpoints/000002.safetensors.partial");
    std::os::unix::fs::symlink("/dev/full", &next).unwrap();
    let message = run.advance().unwrap_err().to_string();
    assert!(message.contains("000002.safetensors"), "{message}");
    assert!(message.contains("No space left"), "{message}");
    assert!(!next.exists(), "what is not whole is removed");
    drop(run);
    let run = Run::resume(&folder, None).unwrap();
    assert_eq!(run.ledger().rollouts, 1);
    assert_same(&finish(run), expected());
}

//! Disks that are full or read-only at any operation of a run.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use covers::presets::Method;
use covers::{Disk, LocalDisk, Run, RunError, RunFolder};

use crate::common::{Scratch, assert_same, checkpoints, expected, finish, full, tiny};

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
        Arc::new(Self { after, done, reason })
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

/// Begins a run, lets it end, sums it up and overwrites it by another, until the disk fails. Notes
/// how many operations there were before each of the four parts.
fn run_until_failure(
    folder: &RunFolder,
    disk: &Arc<Failing>,
    before: &mut Vec<usize>,
) -> Result<(), RunError> {
    let mut begin_part = || before.push(disk.done.load(Ordering::Relaxed));
    begin_part();
    let folder = folder.clone().with_disk(Arc::<Failing>::clone(disk));
    let mut run = Run::start(tiny(Method::Covers), folder.clone())?;
    begin_part();
    learn(&mut run)?;
    begin_part();
    run.summary()?;
    drop(run);
    begin_part();
    Run::start(tiny(Method::Covers), folder.allow_overwriting()).map(|_| ())
}

/// Runs to the end; after a failure nothing but that it failed can be had of the run.
fn learn(run: &mut Run) -> Result<(), RunError> {
    loop {
        match run.advance() {
            Ok(Some(_)) => {}
            Ok(None) => return Ok(()),
            Err(error) => {
                let again = run.advance().unwrap_err();
                assert!(matches!(again, RunError::FailedEarlier), "{again}");
                return Err(error);
            }
        }
    }
}

/// How many operations happen before each failure: in the short version one in the middle of each
/// part.
fn cases(scratch: &Scratch) -> Vec<usize> {
    let (disk, mut parts) = (Failing::new(usize::MAX, ErrorKind::Other), Vec::new());
    run_until_failure(&scratch.run("whole"), &disk, &mut parts).unwrap();
    parts.push(disk.done.load(Ordering::Relaxed));
    if full() {
        return (0..parts[4]).collect();
    }
    let middle = |part: &[usize]| part[0].midpoint(part[1]);
    parts.windows(2).map(middle).collect()
}

#[test]
fn a_disk_that_fails_at_any_operation_costs_nothing_but_time() {
    let scratch = Scratch::new("failing");
    let reasons = [ErrorKind::StorageFull, ErrorKind::ReadOnlyFilesystem];
    let cases = cases(&scratch);
    for (&after, reason) in cases.iter().zip(reasons.into_iter().cycle()) {
        let folder = scratch.run("run");
        let disk = Failing::new(after, reason);
        let error = run_until_failure(&folder, &disk, &mut Vec::new()).unwrap_err();
        let message = error.to_string();
        let is_named = message.contains(folder.path().to_str().unwrap());
        assert!(matches!(error, RunError::Write { .. }), "{message}");
        assert!(is_named && message.contains(&reason.to_string()), "{message}");
        let run = if folder.holds_run() {
            Run::resume(folder.path(), Some(1)).unwrap()
        } else {
            Run::start(tiny(Method::Covers), folder).unwrap()
        };
        assert_same(&finish(run), expected());
    }
    println!("failures after {cases:?} operations");
}

/// A disk on which the parts of one checkpoint find no room: they are links to `/dev/full`.
#[derive(Debug)]
struct Full;

impl Disk for Full {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        if path.to_str().unwrap().contains("000002.safetensors") {
            std::os::unix::fs::symlink("/dev/full", path)?;
        }
        LocalDisk.write(path, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        LocalDisk.append(path, bytes)
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        LocalDisk.sync(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        LocalDisk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        LocalDisk.remove(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        LocalDisk.create_folder(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        LocalDisk.sync_folder(path)
    }
}

#[test]
fn a_full_disk_is_named_and_leaves_the_last_checkpoint() {
    let scratch = Scratch::new("full");
    let disk = scratch.run("run").with_disk(Arc::new(Full));
    let mut run = Run::start(tiny(Method::Covers), disk).unwrap();
    run.advance().unwrap();
    let folder = run.folder().path().to_owned();
    let message = run.advance().unwrap_err().to_string();
    assert!(message.contains("000002.safetensors"), "{message}");
    assert!(message.contains("No space left"), "{message}");
    assert_eq!(checkpoints(&folder).len(), 1, "what is not whole is removed");
    drop(run);
    let resumed = Run::resume(&folder, None).unwrap();
    assert_eq!(resumed.stats().rollouts, 1);
    assert_same(&finish(resumed), expected());
}

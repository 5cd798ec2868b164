//! Disks that are full or read-only at any operation of a run.

use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use covers::presets::Method;
use covers::{Disk, LocalDisk, Run, RunError, RunFolder};

use crate::common::{
    Operation, Scratch, Watched, assert_same, checkpoints, expected, finish, full, tiny,
};

/// A disk whose operations fail from the nth on, and the number of those before; a write that fails
/// leaves half of its bytes.
fn failing(after: usize, reason: ErrorKind) -> (Arc<dyn Disk>, Arc<AtomicUsize>) {
    let done = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&done);
    let disk = Watched(move |operation: &Operation| {
        if count.fetch_add(1, Ordering::Relaxed) < after {
            return Ok(());
        }
        match operation {
            Operation::Write(path, bytes) => LocalDisk.write(path, &bytes[..bytes.len() / 2])?,
            Operation::Append(path, bytes) => LocalDisk.append(path, &bytes[..bytes.len() / 2])?,
            _ => {}
        }
        Err(reason.into())
    });
    (Arc::new(disk), done)
}

/// Begins a run, lets it end, sums it up and overwrites it by another, until the disk fails. Notes
/// how many operations there were before each of the four parts.
fn run_until_failure(
    folder: &RunFolder,
    (disk, done): &(Arc<dyn Disk>, Arc<AtomicUsize>),
    before: &mut Vec<usize>,
) -> Result<(), RunError> {
    let mut begin_part = || before.push(done.load(Ordering::Relaxed));
    begin_part();
    let folder = folder.clone().with_disk(Arc::clone(disk));
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
    let (disk, mut parts) = (failing(usize::MAX, ErrorKind::Other), Vec::new());
    run_until_failure(&scratch.run("whole"), &disk, &mut parts).unwrap();
    parts.push(disk.1.load(Ordering::Relaxed));
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
        let disk = failing(after, reason);
        let error = run_until_failure(&folder, &disk, &mut Vec::new()).unwrap_err();
        let message = error.to_string();
        let is_named = message.contains(folder.path().to_str().unwrap());
        let is_write = matches!(error, RunError::Write { .. } | RunError::DiskFull { .. });
        assert!(is_write, "{message}");
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

/// The parts of one checkpoint find no room: they are links to `/dev/full`.
#[test]
fn a_full_disk_is_named_and_leaves_the_last_checkpoint() {
    let scratch = Scratch::new("full");
    let disk = Watched(|operation: &Operation| match operation {
        Operation::Write(path, _) if path.to_str().unwrap().contains("000002.safetensors") => {
            std::os::unix::fs::symlink("/dev/full", path)
        }
        _ => Ok(()),
    });
    let folder = scratch.run("run").with_disk(Arc::new(disk));
    let mut run = Run::start(tiny(Method::Covers), folder).unwrap();
    run.advance().unwrap();
    let path = run.folder().path().to_owned();
    let message = run.advance().unwrap_err().to_string();
    assert!(message.contains("000002.safetensors"), "{message}");
    assert!(message.contains("No space left"), "{message}");
    assert!(message.contains("A checkpoint needs at least "), "{message}");
    let remedy = format!("Make room, then continue with `covers resume {}`", path.display());
    assert!(message.ends_with(&remedy), "{message}");
    assert_eq!(checkpoints(&path).len(), 1, "what is not whole is removed");
    drop(run);
    let resumed = Run::resume(&path, None).unwrap();
    assert_eq!(resumed.stats().rollouts, 1);
    assert_same(&finish(resumed), expected());
}

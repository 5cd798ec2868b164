//! The checkpoints of a run: the newest few, each durable before an older one goes.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::RunError;
use learner::disk::{Disk, replace};

/// Digits of the number of rollouts in a file's name: enough for the longest run.
const DIGITS: usize = 6;
const ENDING: &str = "safetensors";

/// What was read from the newest checkpoint that is intact.
#[derive(Debug)]
pub(crate) struct Found<T> {
    /// What was read.
    pub value: T,
    /// Where.
    pub path: PathBuf,
    /// Those newer ones that could not be read.
    pub passed_over: Vec<PathBuf>,
    /// What is wrong with each of them.
    pub problems: Vec<String>,
}

/// Writes the checkpoint of a run with this many rollouts; of it and those before it, removes all
/// but the `keep` newest.
pub(crate) fn save(
    disk: &dyn Disk,
    folder: &Path,
    rollouts: usize,
    bytes: &[u8],
    keep: usize,
) -> Result<(), RunError> {
    replace(disk, &path(folder, rollouts), bytes)?;
    let mut checkpoints = list(folder)?;
    checkpoints.retain(|(number, _)| *number <= rollouts);
    for (_, old) in checkpoints.iter().skip(keep) {
        let removed = disk.remove(old);
        removed.map_err(|error| RunError::write(old, error))?;
    }
    Ok(())
}

/// Gives checkpoints another name, so that none of them stands before one that the run will write.
pub(crate) fn put_aside(disk: &dyn Disk, paths: &[PathBuf]) -> Result<(), RunError> {
    for path in paths {
        let moved = disk.rename(path, &path.with_added_extension("damaged"));
        moved.map_err(|error| RunError::write(path, error))?;
    }
    Ok(())
}

/// Where the checkpoint after this many rollouts is.
pub(crate) fn path(folder: &Path, rollouts: usize) -> PathBuf {
    folder.join(format!("{rollouts:0DIGITS$}.{ENDING}"))
}

/// The checkpoints in a folder with their numbers of rollouts, the newest first; links are passed
/// over, since they may lead out of the folder.
pub(crate) fn list(folder: &Path) -> Result<Vec<(usize, PathBuf)>, RunError> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let read = |error| RunError::read(folder, error);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(read)? {
        let entry = entry.map_err(read)?;
        let is_file = entry.file_type().map_err(read)?.is_file();
        if let (Some(rollouts), true) = (rollouts_of(&entry.path()), is_file) {
            found.push((rollouts, entry.path()));
        }
    }
    found.sort_unstable_by(|a, b| b.cmp(a));
    Ok(found)
}

/// The number of rollouts in a checkpoint's name.
pub(crate) fn rollouts_of(path: &Path) -> Option<usize> {
    let digits = path.file_name()?.to_str()?.strip_suffix(".safetensors")?;
    let plain = digits.len() >= DIGITS && digits.bytes().all(|byte| byte.is_ascii_digit());
    plain.then(|| digits.parse().ok())?
}

/// Reads the newest checkpoint that can be read; none where there are no checkpoints. One of a
/// newer version of this crate is an error: its work would be lost.
pub(crate) fn newest<T>(
    folder: &Path,
    read: impl Fn(&Path) -> Result<T, RunError>,
) -> Result<Option<Found<T>>, RunError> {
    let (mut passed_over, mut problems) = (Vec::new(), Vec::new());
    for (_, path) in list(folder)? {
        match read(&path) {
            Ok(value) => {
                return Ok(Some(Found { value, path, passed_over, problems }));
            }
            Err(error @ RunError::Read { .. }) => {
                passed_over.push(path);
                problems.push(error.to_string());
            }
            Err(error) => return Err(error),
        }
    }
    if passed_over.is_empty() {
        return Ok(None);
    }
    Err(RunError::NoCheckpoint { folder: folder.to_owned(), problems: problems.join("; ") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbers_of_rollouts_and_nothing_else() {
        let number = |name: &str| rollouts_of(Path::new(name));
        assert_eq!(number("checkpoints/000120.safetensors"), Some(120));
        assert_eq!(number("1234567.safetensors"), Some(1_234_567));
        for other in [
            "120.safetensors",
            "+00120.safetensors",
            "000120.safetensors.partial",
            "99999999999999999999999.safetensors",
            "000120",
        ] {
            assert_eq!(number(other), None, "{other}");
        }
    }
}

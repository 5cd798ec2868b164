//! Checkpoint files of a run: the newest few are kept, and each is durable before an older one is
//! removed.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::RunError;
use learner::disk::{Disk, write_atomically};

/// Least number of digits of the rollout count in a file name; longer counts use more digits.
const DIGITS: usize = 6;
const EXTENSION: &str = "safetensors";

/// Newest intact checkpoint of a run, and the newer ones that could not be read.
#[derive(Debug)]
pub(crate) struct FoundCheckpoint<T> {
    /// Contents that were read from the checkpoint.
    pub contents: T,
    /// Path of the checkpoint file that was read.
    pub path: PathBuf,
    /// Paths of newer checkpoints that could not be read.
    pub unreadable: Vec<PathBuf>,
    /// Error message for each path in `unreadable`.
    pub problems: Vec<String>,
}

/// Writes a run's checkpoint after `rollouts` rollouts, then removes all but the `keep` newest of
/// the checkpoints up to this one.
pub(crate) fn write_checkpoint(
    disk: &dyn Disk,
    folder: &Path,
    rollouts: usize,
    bytes: &[u8],
    keep: usize,
) -> Result<(), RunError> {
    write_atomically(disk, &checkpoint_path(folder, rollouts), bytes)?;
    let mut checkpoints = list_checkpoints(folder)?;
    // if checkpoints with higher numbers counted, they could push out the one just written
    checkpoints.retain(|(number, _)| *number <= rollouts);
    for (_, old) in checkpoints.iter().skip(keep) {
        disk.remove(old).map_err(RunError::write_error_mapper(old))?;
    }
    Ok(())
}

/// Renames damaged checkpoints to `*.damaged`, so that none is mistaken for the newest one while
/// the run writes further checkpoints.
pub(crate) fn rename_damaged(disk: &dyn Disk, paths: &[PathBuf]) -> Result<(), RunError> {
    for path in paths {
        disk.rename(path, &path.with_added_extension("damaged"))
            .map_err(RunError::write_error_mapper(path))?;
    }
    Ok(())
}

/// Returns the path of a run's checkpoint file after `rollouts` rollouts.
pub(crate) fn checkpoint_path(folder: &Path, rollouts: usize) -> PathBuf {
    folder.join(format!("{rollouts:0DIGITS$}.{EXTENSION}"))
}

/// Lists the checkpoints in a folder with their rollout counts, newest first. Symbolic links are
/// skipped, since they may lead out of the folder.
pub(crate) fn list_checkpoints(folder: &Path) -> Result<Vec<(usize, PathBuf)>, RunError> {
    let read = |error| RunError::cannot_read(folder, error);
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(read)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry.map_err(read)?;
        let is_file = entry.file_type().map_err(read)?.is_file();
        if let (Some(rollouts), true) = (rollouts_in_name(&entry.path()), is_file) {
            found.push((rollouts, entry.path()));
        }
    }
    found.sort_unstable_by(|a, b| b.cmp(a));
    Ok(found)
}

/// Parses the rollout count from the file name of a checkpoint; `None` for other files.
pub(crate) fn rollouts_in_name(path: &Path) -> Option<usize> {
    let digits = path.file_name()?.to_str()?.strip_suffix(".safetensors")?;
    let plain = digits.len() >= DIGITS && digits.bytes().all(|byte| byte.is_ascii_digit());
    plain.then(|| digits.parse().ok())?
}

/// Reads the newest intact checkpoint; `None` if the folder has no checkpoints.
///
/// # Errors
/// [`RunError::NoCheckpoint`] if none is intact, and every error of `read` but a [`RunError::Read`]
/// about the contents of a file. So a checkpoint of a newer version of this
/// crate is never skipped: its training would be lost.
pub(crate) fn read_newest<T>(
    folder: &Path,
    read: impl Fn(&Path) -> Result<T, RunError>,
) -> Result<Option<FoundCheckpoint<T>>, RunError> {
    let (mut unreadable, mut problems) = (Vec::new(), Vec::new());
    for (_, path) in list_checkpoints(folder)? {
        match read(&path) {
            Ok(value) => {
                return Ok(Some(FoundCheckpoint { contents: value, path, unreadable, problems }));
            }
            Err(error @ RunError::Read { .. }) if !error.is_about_access() => {
                unreadable.push(path);
                problems.push(error.to_string());
            }
            Err(error) => return Err(error),
        }
    }
    if unreadable.is_empty() {
        return Ok(None);
    }
    Err(RunError::NoCheckpoint { folder: folder.to_owned(), problems: problems.join("; ") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbers_of_rollouts_and_nothing_else() {
        let number = |name: &str| rollouts_in_name(Path::new(name));
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

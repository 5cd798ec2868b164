//! One writer to a run's folder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

use crate::error::CoversError;

/// The file that the writer of a folder holds.
const LOCK: &str = "lock";

/// The right to write to a folder. The system takes it back when the process ends, however it ends.
#[derive(Debug)]
pub(crate) struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the right to write to `folder` and leaves this process's name there.
    ///
    /// # Errors
    /// [`CoversError::Locked`] names the process that has it; [`CoversError::Write`].
    pub(crate) fn take(folder: &Path) -> Result<Self, CoversError> {
        let path = folder.join(LOCK);
        let write = |error| CoversError::write(&path, error);
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).map_err(write)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::Error(error)) => return Err(write(error)),
            Err(TryLockError::WouldBlock) => {
                return Err(CoversError::Locked {
                    folder: folder.to_owned(),
                    holder: holder(file),
                });
            }
        }
        let command: Vec<String> = std::env::args().collect();
        let name = format!("process {}, `{}`\n", std::process::id(), command.join(" "));
        file.set_len(0)
            .and_then(|()| file.seek(SeekFrom::Start(0)))
            .and_then(|_| file.write_all(name.as_bytes()))
            .map_err(write)?;
        Ok(Self { _file: file })
    }
}

/// The name that the holder of a lock left.
fn holder(file: File) -> String {
    let mut name = Vec::new();
    // a holder that has not written its name yet is named all the same
    let _ = file.take(4096).read_to_end(&mut name);
    let name = String::from_utf8_lossy(&name).trim().to_owned();
    if name.is_empty() {
        "a process that has just begun".to_owned()
    } else {
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_writer_is_told_who_the_first_is() {
        let folder = std::env::temp_dir().join(format!("covers-lock-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let first = Lock::take(&folder).unwrap();
        let message = Lock::take(&folder).unwrap_err().to_string();
        let process = format!("process {}", std::process::id());
        assert!(message.contains(&process), "{message}");
        drop(first);
        Lock::take(&folder).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

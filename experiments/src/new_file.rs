//! Output file of a command: it must not exist yet, and is written atomically.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::RunError;
use crate::folder::file_exists;
use learner::disk::{LocalDisk, PARTIAL_FILE_EXTENSION, parent_folder, write_atomically};

/// Output file of a command, which must not exist yet.
pub struct NewOutputFile {
    path: PathBuf,
}

impl NewOutputFile {
    /// Returns a handle to an output file that does not exist yet; creates nothing.
    ///
    /// # Errors
    /// [`RunError::FileExists`], [`RunError::Read`].
    pub fn new(path: &Path) -> Result<Self, RunError> {
        let path = path.to_owned();
        if file_exists(&path)? { Err(RunError::FileExists { path }) } else { Ok(Self { path }) }
    }

    /// Creates the output file's folder if needed and checks that it can be written to, so that a
    /// command fails before its work and not after it.
    ///
    /// # Errors
    /// [`RunError::Write`]; [`RunError::FileExists`] for a partial file, which another command is
    /// writing or left behind.
    pub fn prepare_folder(&self) -> Result<(), RunError> {
        let write = |error| RunError::cannot_write(&self.path, error);
        fs::create_dir_all(parent_folder(&self.path)).map_err(write)?;
        let path = self.path.with_added_extension(PARTIAL_FILE_EXTENSION);
        match File::create_new(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                Err(RunError::FileExists { path })
            }
            made => made.and_then(|_| fs::remove_file(&path)).map_err(write),
        }
    }

    /// Writes the whole output file atomically.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(&self, bytes: &[u8]) -> Result<(), RunError> {
        Ok(write_atomically(&LocalDisk, &self.path, bytes)?)
    }

    /// Returns the path of the output file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Returns the extension of a file's name in lower case; `None` without one.
pub fn lowercase_extension(path: &Path) -> Option<String> {
    let extension = path.extension()?.to_str()?;
    Some(extension.to_ascii_lowercase())
}

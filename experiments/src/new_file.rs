//! A file that a command makes: it does not exist yet, and appears whole or not at all.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::RunError;
use learner::disk::{LocalDisk, PARTIAL, folder_of, replace};

/// A file that does not exist yet.
pub struct NewFile {
    path: PathBuf,
}

impl NewFile {
    /// A file of this name.
    ///
    /// # Errors
    /// [`RunError::FileExists`].
    pub fn new(path: &Path) -> Result<Self, RunError> {
        let path = path.to_owned();
        match path.exists() {
            true => Err(RunError::FileExists { path }),
            false => Ok(Self { path }),
        }
    }

    /// Makes the file's folder, and tries whether it can be written to.
    ///
    /// # Errors
    /// [`RunError::Write`]; [`RunError::FileExists`] for a part of the file, which another
    /// command writes or left behind.
    pub fn prepare(&self) -> Result<(), RunError> {
        let write = |error| RunError::write(&self.path, error);
        fs::create_dir_all(folder_of(&self.path)).map_err(write)?;
        let path = self.path.with_added_extension(PARTIAL);
        match File::create_new(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                Err(RunError::FileExists { path })
            }
            made => made.and_then(|_| fs::remove_file(&path)).map_err(write),
        }
    }

    /// Writes all of it.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(&self, bytes: &[u8]) -> Result<(), RunError> {
        Ok(replace(&LocalDisk, &self.path, bytes)?)
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The ending of a file's name, in small letters; nothing where there is none, or no name before
/// it.
pub fn ending(path: &Path) -> Option<String> {
    let ending = path.extension()?.to_str()?;
    Some(ending.to_ascii_lowercase())
}

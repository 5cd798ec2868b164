//! A file that a command makes: it does not exist yet, and appears whole or not at all.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::error::CoversError;
use learner::disk::{LocalDisk, PARTIAL, folder_of, replace};

/// A file that does not exist yet.
pub(crate) struct NewFile {
    path: PathBuf,
}

impl NewFile {
    /// A file of this name.
    ///
    /// # Errors
    /// [`CoversError::FileExists`].
    pub fn new(path: &Path) -> Result<Self, CoversError> {
        let path = path.to_owned();
        match path.exists() {
            true => Err(CoversError::FileExists { path }),
            false => Ok(Self { path }),
        }
    }

    /// Makes the file's folder, and tries whether it can be written to.
    ///
    /// # Errors
    /// [`CoversError::Write`]; [`CoversError::FileExists`] for a part of the file, which another
    /// command writes or left behind.
    pub fn prepare(&self) -> Result<(), CoversError> {
        let write = |error| CoversError::write(&self.path, error);
        fs::create_dir_all(folder_of(&self.path)).map_err(write)?;
        let path = self.path.with_added_extension(PARTIAL);
        match File::create_new(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                Err(CoversError::FileExists { path })
            }
            made => made.and_then(|_| fs::remove_file(&path)).map_err(write),
        }
    }

    /// Writes all of it.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn write(&self, bytes: &[u8]) -> Result<(), CoversError> {
        Ok(replace(&LocalDisk, &self.path, bytes)?)
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The ending of a file's name, in small letters; nothing where there is none, or no name before
/// it.
pub(crate) fn ending(path: &Path) -> Option<String> {
    let ending = path.extension()?.to_str()?;
    Some(ending.to_ascii_lowercase())
}

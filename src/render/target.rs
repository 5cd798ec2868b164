//! The file that a film goes to.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::disk::{LocalDisk, PARTIAL, folder_of, replace};
use crate::error::CoversError;

use super::film::Film;
use super::gif;
use super::mp4::Ffmpeg;

/// A file that does not exist yet, in a format that films can be written in.
pub(super) struct Target {
    path: PathBuf,
    /// What encodes an mp4; nothing for a GIF.
    ffmpeg: Option<Ffmpeg>,
}

impl Target {
    /// Checks all that can be checked without writing.
    ///
    /// # Errors
    /// [`CoversError::FilmFormat`], [`CoversError::FileExists`], [`CoversError::NoFfmpeg`].
    pub fn new(path: &Path) -> Result<Self, CoversError> {
        let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
        let ffmpeg = match ending.as_deref().and_then(|ending| ending.to_str()) {
            Some("gif") => None,
            Some("mp4") => {
                let folders = std::env::var_os("PATH").unwrap_or_default();
                Some(Ffmpeg::find(&folders, path)?)
            }
            _ => {
                let path = path.to_owned();
                return Err(CoversError::FilmFormat { path });
            }
        };
        let path = path.to_owned();
        if path.exists() {
            return Err(CoversError::FileExists { path });
        }
        Ok(Self { path, ffmpeg })
    }

    /// Makes the file's folder, and tries whether it can be written to.
    ///
    /// # Errors
    /// [`CoversError::Write`]; [`CoversError::FileExists`] for a part of a film, which a render of
    /// this name writes or left behind.
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

    /// Writes the film; the file appears whole or not at all.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn write(&self, film: &Film) -> Result<(), CoversError> {
        let bytes = match &self.ffmpeg {
            None => gif::encode(film).map_err(|error| CoversError::write(&self.path, error))?,
            Some(ffmpeg) => ffmpeg.encode(film, &self.path)?,
        };
        replace(&LocalDisk, &self.path, &bytes)
    }

    /// Where the film is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

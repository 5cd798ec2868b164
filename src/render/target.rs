//! The file that a film goes to.

use std::fs::{self, File};
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
    /// Checks all that can be checked before there is a film.
    ///
    /// # Errors
    /// [`CoversError::FilmFormat`], [`CoversError::FileExists`], [`CoversError::NoFfmpeg`], and
    /// [`CoversError::Write`] for a folder that nothing can be written to.
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
        let write = |error| CoversError::write(&path, error);
        fs::create_dir_all(folder_of(&path)).map_err(write)?;
        let partial = path.with_added_extension(PARTIAL);
        File::create(&partial).map_err(write)?;
        fs::remove_file(&partial).map_err(write)?;
        Ok(Self { path, ffmpeg })
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

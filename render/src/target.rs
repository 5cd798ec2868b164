//! The file that a film goes to.

use std::path::Path;

use crate::RenderError;
use experiments::RunError;
use experiments::new_file::{NewFile, ending};

use super::gif;
use super::gif::Film;
use super::mp4::Ffmpeg;

/// A file that does not exist yet, in a format that films can be written in.
pub(super) struct Target {
    file: NewFile,
    /// What encodes an mp4; nothing for a GIF.
    ffmpeg: Option<Ffmpeg>,
}

impl Target {
    /// Checks all that can be checked without writing.
    ///
    /// # Errors
    /// [`RenderError::Ending`], [`RunError::FileExists`], [`RenderError::NoFfmpeg`].
    pub fn new(path: &Path) -> Result<Self, RenderError> {
        let ffmpeg = match ending(path).as_deref() {
            Some("gif") => None,
            Some("mp4") => {
                let folders = std::env::var_os("PATH").unwrap_or_default();
                Some(Ffmpeg::find(&folders, path)?)
            }
            _ => {
                return Err(RenderError::Ending {
                    path: path.to_owned(),
                    expected: ".gif or .mp4",
                });
            }
        };
        let file = NewFile::new(path)?;
        Ok(Self { file, ffmpeg })
    }

    /// Makes the file's folder, and tries whether it can be written to.
    ///
    /// # Errors
    /// As [`NewFile::prepare`].
    pub fn prepare(&self) -> Result<(), RunError> {
        self.file.prepare()
    }

    /// Writes the film; the file appears whole or not at all.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(&self, film: &Film) -> Result<(), RunError> {
        let path = self.path();
        let bytes = match &self.ffmpeg {
            None => gif::encode(film).map_err(|error| RunError::write(path, error))?,
            Some(ffmpeg) => ffmpeg.encode(film, path)?,
        };
        self.file.write(&bytes)
    }

    /// Where the film is.
    pub fn path(&self) -> &Path {
        self.file.path()
    }
}

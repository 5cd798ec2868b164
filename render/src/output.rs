//! Output file of a film.

use std::path::Path;

use crate::RenderError;
use experiments::RunError;
use experiments::new_file::{NewOutputFile, lowercase_extension};

use super::gif::{self, Film};
use super::mp4::Ffmpeg;

/// Output file of a film: it must not exist yet, and has the extension of a supported format.
pub(super) struct OutputFile {
    file: NewOutputFile,
    /// Encoder of an mp4; `None` for a GIF.
    ffmpeg: Option<Ffmpeg>,
}

impl OutputFile {
    /// Checks the path of the film without writing anything.
    ///
    /// # Errors
    /// [`RenderError::UnsupportedExtension`], [`RunError::FileExists`], [`RenderError::NoFfmpeg`].
    pub fn new(path: &Path) -> Result<Self, RenderError> {
        let ffmpeg = match lowercase_extension(path).as_deref() {
            Some("gif") => None,
            Some("mp4") => {
                let folders = std::env::var_os("PATH").unwrap_or_default();
                Some(Ffmpeg::find(&folders, path)?)
            }
            _ => {
                return Err(RenderError::UnsupportedExtension {
                    path: path.to_owned(),
                    expected: ".gif or .mp4",
                });
            }
        };
        let file = NewOutputFile::new(path)?;
        Ok(Self { file, ffmpeg })
    }

    /// Creates the file's folder and checks that it can be written to.
    ///
    /// # Errors
    /// As [`NewOutputFile::prepare_folder`].
    pub fn prepare(&self) -> Result<(), RunError> {
        self.file.prepare_folder()
    }

    /// Writes the film atomically: the file is complete or does not exist.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(&self, film: &Film) -> Result<(), RunError> {
        let path = self.path();
        let bytes = match &self.ffmpeg {
            None => gif::encode_gif(film).map_err(RunError::write_error_mapper(path))?,
            Some(ffmpeg) => ffmpeg.encode(film, path)?,
        };
        self.file.write(&bytes)
    }

    /// Returns the path of the film.
    pub fn path(&self) -> &Path {
        self.file.path()
    }
}

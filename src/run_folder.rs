//! The folder of one run: settings as JSON, tables as CSV, pictures as PNG, the learner as
//! safetensors.

use std::fs::{File, create_dir, create_dir_all};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::logs::{Logs, Marks};
use crate::sheet::Picture;

/// The file of a run's settings.
const EXPERIMENT: &str = "experiment.json";

/// A folder that one run alone writes to.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Creates `parent/name`, or `parent/name-2`, `-3`, ... where that exists: no run overwrites
    /// another.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn create(parent: &Path, name: &str) -> Result<Self, CoversError> {
        create_dir_all(parent).map_err(|error| CoversError::write(parent, error))?;
        let mut attempt = 1;
        loop {
            let suffix = if attempt == 1 {
                String::new()
            } else {
                format!("-{attempt}")
            };
            let path = parent.join(format!("{name}{suffix}"));
            match create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => attempt += 1,
                Err(error) => return Err(CoversError::write(&path, error)),
            }
        }
    }

    /// Where the folder is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Creates exactly this folder, which must not exist.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn create_exactly(path: &Path) -> Result<Self, CoversError> {
        create_dir(path).map_err(|error| CoversError::write(path, error))?;
        Ok(Self::open(path))
    }

    /// Names a folder that an earlier run wrote.
    pub fn open(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
        }
    }

    /// The file of the learner as it last was, see [`crate::LearnerSettings::load`].
    pub fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.safetensors")
    }

    /// Reads the run's settings.
    ///
    /// # Errors
    /// [`CoversError::Read`].
    pub fn experiment(&self) -> Result<Experiment, CoversError> {
        Experiment::read(&self.path.join(EXPERIMENT))
    }

    /// Writes the run's settings.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn write_experiment(&self, experiment: &Experiment) -> Result<(), CoversError> {
        let path = self.path.join(EXPERIMENT);
        let text = serde_json::to_string_pretty(experiment);
        let text = text.map_err(|error| CoversError::write(&path, error))? + "\n";
        std::fs::write(&path, text).map_err(|error| CoversError::write(&path, error))
    }

    pub(crate) fn logs(&self, marks: Option<Marks>) -> Result<Logs, CoversError> {
        Logs::open(&self.path, marks)
    }

    /// Writes a picture.
    pub(crate) fn write_png(&self, name: &str, picture: &Picture) -> Result<(), CoversError> {
        let path = self.path.join(name);
        encode_png(&path, picture).map_err(|error| CoversError::write(&path, error))
    }
}

fn encode_png(path: &Path, picture: &Picture) -> Result<(), png::EncodingError> {
    let mut file = BufWriter::new(File::create(path)?);
    let (width, height) = (picture.width as u32, picture.height as u32);
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&picture.rgb)?;
    writer.finish()?;
    Ok(file.flush()?)
}

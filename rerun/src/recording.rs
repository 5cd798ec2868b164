//! Recording in memory, and its timelines.

use std::path::{Path, PathBuf};

use re_sdk::blueprint::Blueprint;
use re_sdk::sink::BinaryStreamStorage;
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};

use covers::RunError;

/// Name of the timeline that counts the decisions of an episode.
pub(crate) const DECISION: &str = "decision";
/// Name of the timeline that counts the rollouts of the stream.
pub(crate) const ROLLOUTS: &str = "rollouts";
/// Name of the timeline that counts the decisions of the stream.
pub(crate) const STREAM: &str = "stream";

/// Rerun recording that grows in memory.
pub(crate) struct Recording {
    path: PathBuf,
    stream: RecordingStream,
    bytes: BinaryStreamStorage,
}

impl Recording {
    /// Creates an empty recording in memory, with `blueprint` as the viewer's layout; `path` is the
    /// file that the caller will write.
    ///
    /// # Errors
    /// [`RunError::Write`] if Rerun's SDK refuses.
    pub fn new(path: &Path, name: &str, blueprint: Blueprint) -> Result<Self, RunError> {
        // the environment variable RERUN may switch recording off, but the user asked for it
        let builder = RecordingStreamBuilder::new("covers")
            .enabled(true)
            .recording_name(name)
            .with_blueprint(blueprint);
        let stream = builder.buffered().map_err(refused(path))?;
        // wall-clock time and the order of calls would be timelines that differ between equal runs
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let bytes = stream.binary_stream();
        let path = path.to_owned();
        Ok(Self { path, stream, bytes })
    }

    /// Returns the path of the file that the caller will write the recording to.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Sets the time of everything that this thread logs from here on, one index for each timeline,
    /// and removes other timelines.
    pub fn set_time(&self, moments: &[(&'static str, usize)]) {
        self.stream.reset_time();
        for &(timeline, moment) in moments {
            self.stream.set_time_sequence(timeline, moment as i64);
        }
    }

    /// Logs `what` at the entity path `place` for the current time.
    ///
    /// # Errors
    /// [`RunError::Write`] if Rerun's SDK refuses.
    pub fn log(&self, place: &str, what: &impl AsComponents) -> Result<(), RunError> {
        let logged = self.stream.log(place, what);
        logged.map_err(refused(&self.path))
    }

    /// Logs `what` at the entity path `place` for all times.
    ///
    /// # Errors
    /// [`RunError::Write`] if Rerun's SDK refuses.
    pub fn log_static(&self, place: &str, what: &impl AsComponents) -> Result<(), RunError> {
        let logged = self.stream.log_static(place, what);
        logged.map_err(refused(&self.path))
    }

    /// Ends the recording and returns the contents of its file, which the caller writes.
    ///
    /// # Errors
    /// [`RunError::Write`] if the recording cannot be encoded.
    pub fn into_bytes(self) -> Result<Vec<u8>, RunError> {
        self.stream.flush_blocking().map_err(refused(&self.path))?;
        let bytes = self.bytes.read();
        bytes.ok_or_else(|| refused(&self.path)("the recording could not be encoded"))
    }
}

/// Returns a function that converts an error of Rerun's SDK to an error of writing the file `path`.
pub(crate) fn refused<E: ToString>(path: &Path) -> impl FnOnce(E) -> RunError {
    move |error| RunError::Write { path: path.to_owned(), source: error.to_string().into() }
}

//! What is logged, and when.

use std::path::{Path, PathBuf};

use re_sdk::blueprint::Blueprint;
use re_sdk::sink::BinaryStreamStorage;
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder};

use covers::CoversError;

/// The decisions of an episode.
pub(crate) const DECISION: &str = "decision";
/// Rollouts of the stream so far.
pub(crate) const ROLLOUTS: &str = "rollouts";
/// Decisions of the stream so far.
pub(crate) const STREAM: &str = "stream";

/// A recording that grows in memory.
pub(crate) struct Recording {
    path: PathBuf,
    stream: RecordingStream,
    bytes: BinaryStreamStorage,
}

impl Recording {
    /// An empty recording for the file `path`, which the viewer lays out as `blueprint` says.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn new(path: &Path, name: &str, blueprint: Blueprint) -> Result<Self, CoversError> {
        // whatever the environment variable RERUN says: a recording was asked for
        let builder = RecordingStreamBuilder::new("covers")
            .enabled(true)
            .recording_name(name)
            .with_blueprint(blueprint);
        let stream = builder.buffered().map_err(refused(path))?;
        // the clock on the wall and the order of calls are no timelines of a run
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        let bytes = stream.binary_stream();
        let path = path.to_owned();
        Ok(Self { path, stream, bytes })
    }

    /// The file that it is for.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is logged from here on by this thread happens at these points of timelines, and of no
    /// other.
    pub fn at(&self, moments: &[(&'static str, usize)]) {
        self.stream.reset_time();
        for &(timeline, moment) in moments {
            self.stream.set_time_sequence(timeline, moment as i64);
        }
    }

    /// Logs what changes with time.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn log(&self, place: &str, what: &impl AsComponents) -> Result<(), CoversError> {
        let logged = self.stream.log(place, what);
        logged.map_err(refused(&self.path))
    }

    /// Logs what is so at all times.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn state(&self, place: &str, what: &impl AsComponents) -> Result<(), CoversError> {
        let logged = self.stream.log_static(place, what);
        logged.map_err(refused(&self.path))
    }

    /// The file.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn finish(self) -> Result<Vec<u8>, CoversError> {
        self.stream.flush_blocking().map_err(refused(&self.path))?;
        let bytes = self.bytes.read();
        bytes.ok_or_else(|| refused(&self.path)("the recording could not be encoded"))
    }
}

/// The error of a recording that does not come about.
pub(crate) fn refused<E: ToString>(path: &Path) -> impl FnOnce(E) -> CoversError {
    move |error| CoversError::Write { path: path.to_owned(), source: error.to_string().into() }
}

//! Snapshot of a run's folder, read again when a file changes.

use std::fs;
use std::path::Path;
#[cfg(feature = "tui")]
use std::time::Duration;
use std::time::SystemTime;

use experiments::{RunData, RunError, RunFolder, SUMMARY_FILE};

/// Names of the files in a run's folder whose changes are noticed.
const FILES: [&str; 4] = ["metrics.csv", "timings.csv", "evaluation.csv", SUMMARY_FILE];

/// Length and modification time of a file; `None` if it does not exist.
type Stamp = Option<(u64, SystemTime)>;

/// Contents of a run's folder when it was last read.
pub(super) struct RunSnapshot {
    pub folder: RunFolder,
    pub run: RunData,
    /// `true` if the run was finished.
    pub finished: bool,
    stamps: [Stamp; FILES.len()],
}

impl RunSnapshot {
    /// Takes a snapshot of a run: reads the settings and tables in its folder.
    ///
    /// # Errors
    /// As [`RunData::read_partial`].
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::from_path(path);
        // before the tables are read, so that later changes are noticed by `refresh`
        let (stamps, finished) = (stamps(&folder), folder.is_finished());
        Ok(Self { run: RunData::read_partial(path)?, finished, stamps, folder })
    }

    /// Reads the run's folder again if a file changed; returns `true` if one did.
    ///
    /// # Errors
    /// As [`RunData::read_partial`].
    pub fn refresh(&mut self) -> Result<bool, RunError> {
        let changed = stamps(&self.folder) != self.stamps;
        if changed {
            *self = Self::open(self.folder.path())?;
        }
        Ok(changed)
    }

    /// Returns the time since the latest change of a file that this snapshot holds; `None` if it
    /// holds none.
    #[cfg(feature = "tui")]
    pub fn time_since_change(&self) -> Option<Duration> {
        let newest = self.stamps.iter().flatten().map(|stamp| stamp.1).max()?;
        // a clock may have been set back
        Some(newest.elapsed().unwrap_or(Duration::ZERO))
    }
}

fn stamps(folder: &RunFolder) -> [Stamp; FILES.len()] {
    FILES.map(|name| {
        let file = fs::metadata(folder.file_path(name)).ok()?;
        Some((file.len(), file.modified().ok()?))
    })
}

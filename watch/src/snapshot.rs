//! A run as its folder tells it, read again when a file changed.

use std::fs;
use std::path::Path;
#[cfg(feature = "tui")]
use std::time::Duration;
use std::time::SystemTime;

use experiments::{RunData, RunError, RunFolder, SUMMARY};

/// The files that are looked at.
const FILES: [&str; 4] = ["metrics.csv", "timings.csv", "evaluation.csv", SUMMARY];

/// Length and time of a file; nothing of one that is not there.
type Stamp = Option<(u64, SystemTime)>;

/// What a folder said when it was read last.
pub(super) struct View {
    pub folder: RunFolder,
    pub run: RunData,
    /// Whether the run was at its end.
    pub finished: bool,
    stamps: [Stamp; FILES.len()],
}

impl View {
    /// Reads the folder of a run.
    ///
    /// # Errors
    /// As [`RunData::so_far`].
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::open(path);
        // before the tables are read: what comes after them is not missed
        let (stamps, finished) = (stamps(&folder), folder.is_finished());
        Ok(Self { run: RunData::so_far(path)?, finished, stamps, folder })
    }

    /// Reads the folder again where a file changed, and says whether one did.
    ///
    /// # Errors
    /// As [`RunData::so_far`].
    pub fn refresh(&mut self) -> Result<bool, RunError> {
        let changed = stamps(&self.folder) != self.stamps;
        if changed {
            *self = Self::open(self.folder.path())?;
        }
        Ok(changed)
    }

    /// How long nothing has come.
    #[cfg(feature = "tui")]
    pub fn silence(&self) -> Option<Duration> {
        let newest = self.stamps.iter().flatten().map(|stamp| stamp.1).max()?;
        // a clock may have been set back
        Some(newest.elapsed().unwrap_or(Duration::ZERO))
    }
}

fn stamps(folder: &RunFolder) -> [Stamp; FILES.len()] {
    FILES.map(|name| {
        let file = fs::metadata(folder.file(name)).ok()?;
        Some((file.len(), file.modified().ok()?))
    })
}

//! `covers watch`: follows a run while it trains.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use clap::Args;
use serde_json::Value;

use crate::WatchError;
use experiments::cli::print_escaped;
use experiments::text::ROLLOUT_LINE_HEADER;
use experiments::{RunError, RunFolder, SUMMARY_FILE};

use super::events::{EventFeed, RunEvent};
use super::snapshot::RunSnapshot;

/// Polling interval of the run's folder while lines are printed.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// Options of `covers watch`: the run and the output format.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  covers watch runs/covers-sac-seed0\n  \
    covers watch runs/covers-sac-seed0 --json | jq .reward")]
pub struct WatchOptions {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Print a JSON object a line, one for each rollout and evaluation, and one for the end.
    #[arg(long)]
    pub json: bool,
}

impl WatchOptions {
    /// Shows the run on the terminal until the user quits; if standard output is not a terminal or
    /// JSON is requested, prints its events to `out` until the run is finished. Returns the exit
    /// code of the process: 0, or 128 plus the number of the signal that ended it.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`RunError::PackedRun`], files that cannot be read, an `out` that
    /// cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<u8, WatchError> {
        #[cfg(feature = "tui")]
        if !self.json && std::io::IsTerminal::is_terminal(&std::io::stdout()) {
            return Ok(super::screen::watch_run(self.open()?)?);
        }
        self.print_events(out).map(|()| 0)
    }

    fn open(&self) -> Result<RunSnapshot, WatchError> {
        let opened = RunFolder::from_path(&self.run_folder);
        if !opened.holds_run() {
            return Err(opened.no_run().into());
        }
        if opened.is_packed() {
            let folder = self.run_folder.clone();
            return Err(RunError::PackedRun { folder }.into());
        }
        Ok(RunSnapshot::open(&self.run_folder)?)
    }

    /// Prints a line for each rollout and evaluation to `out` until the run is finished, and one
    /// for its end.
    ///
    /// # Errors
    /// As [`WatchOptions::run`].
    pub fn print_events(&self, out: &mut impl Write) -> Result<(), WatchError> {
        let mut snapshot = self.open()?;
        let mut feed = EventFeed::default();
        if !self.json {
            print_escaped(out, ROLLOUT_LINE_HEADER)?;
        }
        let mut print = |event: &RunEvent<'_>| {
            print_escaped(out, &if self.json { event.json_line() } else { event.text_line() })
        };
        loop {
            feed.new_events(&snapshot.run).iter().try_for_each(&mut print)?;
            if snapshot.finished {
                let summary = summary(&snapshot.folder)?;
                return Ok(print(&RunEvent::Finished { summary })?);
            }
            while !snapshot.refresh()? {
                sleep(POLL_INTERVAL);
            }
        }
    }
}

fn summary(folder: &RunFolder) -> Result<Value, RunError> {
    let path = folder.file_path(SUMMARY_FILE);
    let text = fs::read(&path).map_err(RunError::read_error_mapper(&path))?;
    serde_json::from_slice(&text).map_err(RunError::read_error_mapper(&path))
}

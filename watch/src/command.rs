//! `covers watch`: a run while it goes on.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use clap::Args;
use serde_json::Value;

use crate::WatchError;
use experiments::cli::say;
use experiments::{RunError, RunFolder, SUMMARY};

use super::told::{Teller, Told};
use super::view::View;

/// From one look at the folder to the next, where lines are printed.
const EVERY: Duration = Duration::from_millis(500);

/// The first file that a run leaves, and one that it has all along.
const TRACES: [&str; 2] = ["lock", "metrics.csv"];

/// What to watch.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  covers watch runs/covers-seed0\n  \
    covers watch runs/covers-seed0 --json | jq .reward")]
pub struct WatchOptions {
    /// The run's folder.
    pub run: PathBuf,
    /// Print a JSON object a line, one for each rollout and evaluation, and one for the end.
    #[arg(long)]
    pub json: bool,
}

impl WatchOptions {
    /// Shows the run on the terminal until somebody quits or, where standard output is none, prints
    /// a line for each rollout and evaluation until the run is finished. Returns the process's exit
    /// code: 0, or 128 and the number of the signal that ended it.
    ///
    /// # Errors
    /// [`RunError::NoRun`], [`WatchError::NoTables`], files that cannot be read, an `out` that
    /// cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<u8, WatchError> {
        #[cfg(feature = "tui")]
        if !self.json && std::io::IsTerminal::is_terminal(&std::io::stdout()) {
            return Ok(super::screen::watch(self.open()?)?);
        }
        self.print(out).map(|()| 0)
    }

    fn open(&self) -> Result<View, WatchError> {
        let folder = RunFolder::open(&self.run);
        if !folder.holds_run() {
            let folder = self.run.clone();
            return Err(RunError::NoRun { folder }.into());
        }
        // a run that has just begun has no tables yet
        if !TRACES.iter().any(|name| folder.file(name).exists()) {
            let folder = self.run.clone();
            return Err(WatchError::NoTables { folder });
        }
        Ok(View::open(&self.run)?)
    }

    /// Prints a line for each rollout and evaluation until the run is finished, whatever standard
    /// output is.
    ///
    /// # Errors
    /// As [`WatchOptions::run`].
    pub fn print(&self, out: &mut impl Write) -> Result<(), WatchError> {
        let mut view = self.open()?;
        let mut teller = Teller::default();
        let mut tell = |told: &Told<'_>| match self.json {
            true => say(out, &told.json()),
            false => say(out, &told.line()),
        };
        loop {
            teller.news(&view.run).iter().try_for_each(&mut tell)?;
            if view.finished {
                let summary = summary(&view.folder)?;
                return Ok(tell(&Told::Finished { summary })?);
            }
            while !view.refresh()? {
                sleep(EVERY);
            }
        }
    }
}

fn summary(folder: &RunFolder) -> Result<Value, RunError> {
    let path = folder.file(SUMMARY);
    let text = fs::read(&path).map_err(|error| RunError::read(&path, error))?;
    serde_json::from_slice(&text).map_err(|error| RunError::read(&path, error))
}

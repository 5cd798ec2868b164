//! Early end of a run.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use crate::error::RunError;

/// Request that a run stops at the next moment at which nothing is lost. Clones share one request.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// A request that Ctrl-C, SIGTERM and SIGHUP make. The second Ctrl-C or SIGTERM ends the
    /// process at once, with 128 and the signal's number as its exit code.
    ///
    /// A terminal that closes may send SIGHUP more than once, so SIGHUP never ends the process at
    /// once. Under `nohup` it stays ignored.
    ///
    /// # Errors
    /// [`RunError::Signals`].
    pub fn on_signals() -> Result<Self, RunError> {
        let stop = Self::default();
        let failed = |source| RunError::Signals { source };
        // not the request itself, which SIGHUP and a closed output make, too
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // first: the first signal must not find the flag set by itself
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&signalled))
                .and_then(|_| flag::register(signal, Arc::clone(&signalled)))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.0)))
                .map_err(failed)?;
        }
        if !hangup_is_ignored() {
            flag::register(SIGHUP, Arc::clone(&stop.0)).map_err(failed)?;
        }
        Ok(stop)
    }

    /// Requests the stop.
    pub fn request(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// `true` once it was requested.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// `true` if the process was started with SIGHUP ignored, as `nohup` does.
fn hangup_is_ignored() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_some_and(|mask| mask >> (SIGHUP - 1) & 1 == 1)
}

//! Signal that stops a run early.

use std::fs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;

use rl::ProcessRanks;

use crate::error::RunError;

/// Flag that asks runs to stop at the next point where no work is lost. Clones share one request.
#[derive(Clone, Debug, Default)]
pub struct StopSignal {
    requested: Arc<AtomicBool>,
    /// `true` once a call of [`StopSignal::is_requested`] has returned `true`.
    seen: Arc<AtomicBool>,
    ranks: ProcessRanks,
}

impl StopSignal {
    /// Installs signal handlers, and returns the stop signal that SIGINT (Ctrl-C), SIGTERM and
    /// SIGHUP set from then on. The second SIGINT or SIGTERM ends the process at once, with 128
    /// plus the signal's number as exit code.
    ///
    /// SIGHUP never ends the process at once, since a terminal that closes may send it more than
    /// once. Under `nohup` it stays ignored.
    ///
    /// # Errors
    /// [`RunError::SignalHandlers`].
    pub fn from_os_signals() -> Result<Self, RunError> {
        let stop = Self::default();
        let failed = |source| RunError::SignalHandlers { source };
        // a flag of its own, since SIGHUP and a closed output also set the request, and the first
        // SIGINT after them must not end the process
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // actions run in the order of registration, so the check comes before the flag is set
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&signalled))
                .and_then(|_| flag::register(signal, Arc::clone(&signalled)))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.requested)))
                .map_err(failed)?;
        }
        if !hangup_is_ignored() {
            flag::register(SIGHUP, Arc::clone(&stop.requested)).map_err(failed)?;
        }
        Ok(stop)
    }

    /// Requests that runs with this signal stop.
    pub fn request(&self) {
        self.requested.store(true, Ordering::SeqCst);
    }

    /// Returns a stop signal that all `ranks` see once it is requested on one of them. They must
    /// call [`StopSignal::is_requested`] equally often.
    pub(crate) fn on_ranks(self, ranks: ProcessRanks) -> Self {
        // what one process alone has seen must not keep it from asking the others
        Self { ranks, seen: Arc::default(), ..self }
    }

    /// Returns `true` once a stop of the run was requested, on this rank or another one.
    pub fn is_requested(&self) -> bool {
        if !self.was_seen() {
            let own = self.requested.load(Ordering::SeqCst);
            let requests = self.ranks.all_gather_numbers(own.into());
            self.seen.store(requests.contains(&1), Ordering::SeqCst);
        }
        self.was_seen()
    }

    /// Returns `true` once [`StopSignal::is_requested`] has returned `true`.
    pub(crate) fn was_seen(&self) -> bool {
        self.seen.load(Ordering::SeqCst)
    }
}

/// Catches SIGXFSZ, the signal of a write beyond `ulimit -f`, so that the write fails with an error
/// instead of ending the process without a message.
///
/// # Errors
/// [`RunError::SignalHandlers`].
pub fn catch_file_size_signal() -> Result<(), RunError> {
    let registered = flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
    registered.map(|_| ()).map_err(|source| RunError::SignalHandlers { source })
}

/// Returns `true` if the process was started with SIGHUP ignored, as `nohup` does.
fn hangup_is_ignored() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    // bit 0 of the mask is signal 1
    ignored.is_some_and(|mask| mask >> (SIGHUP - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A terminal asks on one rank alone, which must not decide for that rank.
    #[test]
    fn ranks_agree_on_a_stop_that_another_clone_has_seen() {
        let stop = StopSignal::default();
        stop.request();
        assert!(stop.is_requested() && stop.was_seen());
        let on_ranks = stop.on_ranks(ProcessRanks::default());
        assert!(!on_ranks.was_seen());
        assert!(on_ranks.is_requested() && on_ranks.was_seen());
    }
}

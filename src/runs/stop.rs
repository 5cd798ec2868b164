//! The wish that a run ends early.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::error::CoversError;

/// Says that a run shall stop at the next moment at which nothing is lost. Clones are one and the
/// same wish.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// A wish that Ctrl-C and SIGTERM express. The second of these signals ends the process at
    /// once, with 128 and the signal's number as its exit code.
    ///
    /// # Errors
    /// [`CoversError::Signals`].
    pub fn on_signals() -> Result<Self, CoversError> {
        let stop = Self::default();
        for signal in [SIGINT, SIGTERM] {
            // the order counts: the first signal finds no wish yet
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&stop.0))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.0)))
                .map_err(|source| CoversError::Signals { source })?;
        }
        Ok(stop)
    }

    /// Expresses the wish.
    pub fn request(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether it was expressed.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

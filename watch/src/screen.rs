//! Full-screen view of a run on a terminal.

mod curves;
mod distances;
mod draw;
mod panels;
mod session;
mod terminal;
#[cfg(test)]
mod tests;

use super::progress::StreamProgress;
use super::snapshot::RunSnapshot;

pub use session::train_with_screen;
pub(crate) use session::watch_run;

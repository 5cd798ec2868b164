//! Full-screen view of a run on a terminal.

mod curves;
mod distances;
mod draw;
mod panels;
mod session;
mod terminal;
#[cfg(test)]
mod tests;

use super::progress::Progress;
use super::snapshot::RunSnapshot;

pub use session::train;
pub(crate) use session::watch;

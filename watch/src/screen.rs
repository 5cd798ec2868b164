//! Screen of a run on the terminal.

mod curves;
mod distances;
mod draw;
mod groups;
mod ink;
mod picture;
mod ratios;
mod session;
mod strips;
mod terminal;
#[cfg(test)]
mod tests;

use super::pace::Pace;
use super::view::View;

pub use session::train;
pub(crate) use session::watch;

//! A run on the terminal: what is drawn is in [`draw`], and what is read in [`View`].

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

pub(crate) use session::train;
pub(super) use session::watch;

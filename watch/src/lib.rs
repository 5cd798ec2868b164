//! A run while it goes on: as a screen, as lines, or as JSON, from the tables in its folder.

mod command;
mod error;
mod pace;
#[cfg(feature = "tui")]
pub mod screen;
mod told;
mod view;

pub use command::WatchOptions;
pub use error::WatchError;

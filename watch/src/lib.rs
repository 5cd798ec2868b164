//! Live view of a run as a screen, as lines or as JSON, from the tables in its folder.

mod command;
mod error;
mod events;
mod progress;
#[cfg(feature = "tui")]
pub mod screen;
mod snapshot;

pub use command::WatchOptions;
pub use error::WatchError;

//! Runs as TensorBoard's event files.

mod run;
mod summary;

pub use run::write_events;

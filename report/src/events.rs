//! Runs as TensorBoard's event files.

mod record;
mod run;
mod summary;

pub use run::write_events;

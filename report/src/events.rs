//! TensorBoard's event files of runs.

mod run;
mod summary;

pub use run::write_tensorboard_events;

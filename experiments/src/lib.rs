//! Runs of a learner on a stream of table-top tasks.
//!
//! - [`Stream`]: task groups on MuJoCo as an environment that a [`learner::Learner`] trains on.
//! - [`Experiment`]: all settings of a run; [`presets`] has those of each method.
//! - [`Run`]: a whole run with its files, as `examples/continual_stream.rs` shows; it can stop
//!   anywhere and go on later.
//! - [`RunData`]: the files of a run read back; [`RolloutRow`] and its siblings are their rows.

mod checkpoints;
pub mod cli;
pub mod colours;
mod error;
pub mod evaluation;
mod experiment;
mod folder;
mod glimpse;
mod ledger;
mod lock;
mod logs;
pub mod memory;
pub mod new_file;
mod note;
mod opening;
pub mod presets;
pub mod printable;
mod progress;
mod provenance;
mod rows;
mod run;
mod run_data;
pub mod schedule;
mod schema;
mod scoring;
pub mod sheet;
mod stop;
mod stream;
mod table;
pub mod text;
pub mod timings;
mod workers;
mod world;

pub use error::RunError;
pub use experiment::{CheckpointPlan, EvaluationPlan, Experiment};
pub use folder::{RunFolder, SUMMARY};
pub use glimpse::Glimpse;
pub use ledger::{Ledger, acting};
pub use progress::Summary;
pub use progress::{Evaluation, Event, Progress};
pub use provenance::{Provenance, instructions, processor};
pub use run::Run;
pub use run_data::{GroupFilm, RunData};
pub use schema::{RecognitionRow, RolloutRow, ScoreRow, TimingRow, UnitsRow};
pub use stop::Stop;
pub use stream::{INPUTS, Stream, scale};
pub use workers::thread_pool;

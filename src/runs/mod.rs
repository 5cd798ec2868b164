//! Runs: a learner on a stream, with files that survive whatever happens to the process.

mod checkpoints;
mod folder;
mod heirs;
mod ledger;
mod lock;
mod logs;
mod note;
mod opening;
mod progress;
mod provenance;
mod rows;
mod run;
mod scoring;
mod stop;
mod summary;
mod table;
mod timings;
mod workers;

pub use folder::RunFolder;
pub(crate) use folder::SUMMARY;
pub(crate) use heirs::acting;
pub use ledger::Ledger;
pub use progress::{Evaluation, Event, Progress};
pub use provenance::Provenance;
pub(crate) use provenance::{instructions, processor};
pub use run::Run;
pub(crate) use scoring::looks;
pub use stop::Stop;
pub use summary::Summary;
pub use workers::thread_pool;

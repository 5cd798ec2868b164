//! Runs of a learner on a stream of table-top tasks.
//!
//! - [`SwitchableVecEnv`]: task groups on MuJoCo as an environment that a [`learner::Learner`]
//!   trains on.
//! - [`Experiment`]: all settings of a run; [`presets`] has those of each method.
//! - [`Run`]: a whole run with its files, as `examples/continual_stream.rs` shows. It can be
//!   stopped at any rollout and resumed later.
//! - [`RunData`]: the files of a run read back; [`RolloutRow`] and its siblings are their rows.

mod checkpoints;
pub mod cli;
pub mod colours;
mod error;
pub mod evaluation;
mod experiment;
mod folder;
mod latest_frame;
mod lock;
mod logs;
pub mod memory;
mod nearest_preset;
pub mod new_file;
mod note;
pub mod presets;
pub mod printable;
mod progress;
mod provenance;
mod rows;
mod run;
mod run_data;
mod run_stats;
pub mod schedule;
mod scheduled_vec_env;
mod schema;
mod scoring;
mod settings_check;
pub mod sheet;
mod start_resume;
mod stop;
mod stream;
mod table;
pub mod text;
pub mod timings;
mod workers;

pub use error::RunError;
pub use experiment::{CheckpointPlan, EvaluationPlan, Experiment};
pub use folder::{FileStamps, RunFolder, SUMMARY_FILE};
pub use latest_frame::LatestFrame;
pub use nearest_preset::NearestPreset;
pub use progress::{
    EvaluationReport, RolloutReport, RunEvent, RunSummary, environment_failure_warning,
};
pub use provenance::{Provenance, cpu_instruction_sets, processor_name};
pub use run::Run;
pub use run_data::{GroupFilm, RunData};
pub use run_stats::{RunStats, surviving_policy};
pub use schema::{DormantUnitsRow, RecognitionRow, RolloutRow, ScoreRow, TimingRow};
pub use stop::{StopSignal, catch_file_size_signal};
pub use stream::{SwitchableVecEnv, VECTOR_INPUT_SCALING, scale_observation_vectors};
pub use workers::thread_pool;

//! Reports of runs: tables of methods with intervals over seeds, curves, one HTML page and
//! TensorBoard events.
//!
//! Everything is computed from the files of the runs' folders; nothing is edited by hand.

mod charts;
mod command;
mod comparison;
mod curves;
mod efficiency;
mod error;
mod events;
#[cfg(test)]
mod fixtures;
mod format;
mod learning_curves;
mod matching;
mod matrix;
mod method;
mod metrics;
mod page;
mod paper;
mod per_visit;
mod preset_match;
mod recognition;
mod report;
mod statistics;
pub mod svg;
mod table;
mod tables;
mod visits;

pub use command::ReportOptions;
pub use efficiency::{SOLVED_SUCCESS, SampleEfficiency};
pub use error::ReportError;
pub use method::MethodRuns;
pub use metrics::{GroupMetrics, RunMetrics, UndefinedReason};
pub use preset_match::PresetMatch;
pub use report::Report;
pub use statistics::{ConfidenceInterval, MethodScores, interquartile_mean};
pub use table::ReportTable;

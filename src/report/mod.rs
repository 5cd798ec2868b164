//! What finished runs say: the table of methods, with intervals over seeds.
//!
//! Everything comes from the files of the runs' folders; nothing is edited by hand.

mod after_visits;
mod bands;
mod cells;
mod command;
mod comparison;
mod curves;
mod document;
mod efficiency;
mod figures;
mod films;
mod identity;
mod matrix;
mod method;
mod page;
mod paper;
mod partners;
mod png;
mod recognition;
mod rows;
mod run_data;
mod statistics;
pub(crate) mod svg;
mod table;
mod tables;
mod visits;

pub use command::ReportOptions;
pub use document::Report;
pub use efficiency::{Efficiency, SOLVED};
pub use figures::{Figures, GroupFigures, Undefined};
pub use identity::Identity;
pub use method::MethodRuns;
pub use rows::{RecognitionRow, RolloutRow, ScoreRow, TimingRow, UnitsRow};
pub use run_data::{GroupFilm, RunData};
pub use statistics::{Interval, Scores, iqm, mean};
pub use table::Table;

//! What finished runs say: the table of methods, with intervals over seeds.
//!
//! Everything comes from the files of the runs' folders; nothing is edited by hand.

mod cells;
mod comparison;
mod curves;
mod document;
mod efficiency;
mod figures;
mod identity;
mod method;
mod paper;
mod partners;
mod recognition;
mod run_data;
mod statistics;
mod svg;
mod table;
mod tables;

pub use document::Report;
pub use efficiency::{Efficiency, SOLVED};
pub use figures::{Figures, GroupFigures, Undefined};
pub use identity::Identity;
pub use method::MethodRuns;
pub use run_data::{RecognitionRow, RolloutRow, RunData, ScoreRow, UnitsRow};
pub use statistics::{Interval, Scores, iqm, mean};
pub use table::Table;

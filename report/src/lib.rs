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
mod error;
mod events;
mod figures;
mod identity;
mod matrix;
mod method;
mod page;
mod paper;
mod partners;
mod recognition;
mod statistics;
pub mod svg;
mod table;
mod tables;
mod visits;

pub use command::ReportOptions;
pub use document::Report;
pub use efficiency::{Efficiency, SOLVED};
pub use error::ReportError;
pub use figures::{Figures, GroupFigures, Undefined};
pub use identity::Identity;
pub use method::MethodRuns;
pub use statistics::{Interval, Scores, iqm};
pub use table::Table;

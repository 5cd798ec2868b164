//! Text of table cells.

use super::method::MethodRuns;
use super::metrics::Undefined;
use super::statistics::Interval;
use super::table::Table;
use experiments::evaluation::mean;

/// Returns the name of a method, with a footnote if its settings are not those of the preset of
/// this name.
pub(super) fn title(table: &mut Table, method: &MethodRuns) -> String {
    footnoted(table, method, &method.name)
}

/// Returns the name of a method or of one of its runs, with a footnote if the method's settings are
/// not those of the preset of this name.
pub(super) fn footnoted(table: &mut Table, method: &MethodRuns, name: &str) -> String {
    let remark = method.preset.remark.as_ref();
    remark.map_or_else(|| name.to_owned(), |remark| format!("{name} {}", table.note(remark)))
}

/// Returns the mean over the seeds that have a metric; a footnote with the reason if none has it.
pub(super) fn cell(table: &mut Table, metrics: &[Result<f64, Undefined>]) -> String {
    let known: Vec<f64> = metrics.iter().filter_map(|metric| metric.ok()).collect();
    match (known.is_empty(), metrics.first()) {
        (true, Some(Err(reason))) => format!("- {}", table.note(reason)),
        (true, _) => dash(),
        (false, _) => format!("{:.3}", mean(&known)),
    }
}

/// Returns an interval in brackets, to stand behind its estimate; empty if there is none.
pub(super) fn brackets(interval: Option<Interval>, digits: usize) -> String {
    interval.map_or_else(String::new, |Interval { low, high }| {
        format!(" [{low:.digits$}, {high:.digits$}]")
    })
}

/// Returns the mark of a cell without a number.
pub(super) fn dash() -> String {
    "-".to_owned()
}

//! Text of table cells.

use super::method::MethodRuns;
use super::metrics::UndefinedReason;
use super::statistics::BootstrapInterval;
use super::table::Table;
use experiments::evaluation::mean;

/// Returns the name of a method, with a footnote if its settings are not those of the preset of
/// this name.
pub(super) fn method_cell(table: &mut Table, method: &MethodRuns) -> String {
    with_preset_footnote(table, method, &method.name)
}

/// Returns the name of a method or of one of its runs, with a footnote if the method's settings are
/// not those of the preset of this name.
pub(super) fn with_preset_footnote(table: &mut Table, method: &MethodRuns, name: &str) -> String {
    let remark = method.preset_match.warning.as_ref();
    remark
        .map_or_else(|| name.to_owned(), |remark| format!("{name} {}", table.add_footnote(remark)))
}

/// Returns the mean over the seeds that have a metric; a footnote with the reason if none has it.
pub(super) fn mean_cell(table: &mut Table, metrics: &[Result<f64, UndefinedReason>]) -> String {
    let known: Vec<f64> = metrics.iter().filter_map(|metric| metric.ok()).collect();
    match (known.is_empty(), metrics.first()) {
        (true, Some(Err(reason))) => format!("- {}", table.add_footnote(reason)),
        (true, _) => empty_cell(),
        (false, _) => format!("{:.3}", mean(&known)),
    }
}

/// Formats a confidence interval in brackets, to stand behind its estimate; empty if there is none.
pub(super) fn bracketed_interval(interval: Option<BootstrapInterval>, digits: usize) -> String {
    interval.map_or_else(String::new, |BootstrapInterval { low, high }| {
        format!(" [{low:.digits$}, {high:.digits$}]")
    })
}

/// Returns the mark of a cell without a number.
pub(super) fn empty_cell() -> String {
    "-".to_owned()
}

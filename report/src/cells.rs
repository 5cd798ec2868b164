//! Cells of tables.

use super::figures::Undefined;
use super::method::MethodRuns;
use super::statistics::Interval;
use super::table::Table;
use experiments::evaluation::mean;

/// The name of a method, marked where its settings are not those of the preset of this name.
pub(super) fn title(table: &mut Table, method: &MethodRuns) -> String {
    marked(table, method, &method.name)
}

/// The name of one of a method's runs, or of the method, marked likewise.
pub(super) fn marked(table: &mut Table, method: &MethodRuns, name: &str) -> String {
    let remark = method.identity.remark.as_ref();
    remark.map_or_else(|| name.to_owned(), |remark| format!("{name} {}", table.note(remark)))
}

/// The mean over seeds of a figure that some of them may not have; why, where none has it.
pub(super) fn cell(table: &mut Table, figures: &[Result<f64, Undefined>]) -> String {
    let known: Vec<f64> = figures.iter().filter_map(|figure| figure.ok()).collect();
    match (known.is_empty(), figures.first()) {
        (true, Some(Err(reason))) => format!("- {}", table.note(reason)),
        (true, _) => dash(),
        (false, _) => format!("{:.3}", mean(&known)),
    }
}

/// An interval behind its figure; nothing where there is none.
pub(super) fn brackets(interval: Option<Interval>, digits: usize) -> String {
    interval.map_or_else(String::new, |Interval { low, high }| {
        format!(" [{low:.digits$}, {high:.digits$}]")
    })
}

/// What stands where there is no figure.
pub(super) fn dash() -> String {
    "-".to_owned()
}

//! Text of table cells.

use super::method::MethodRuns;
use super::metrics::{NOT_EVALUATED, UndefinedReason};
use super::statistics::ConfidenceInterval;
use super::table::ReportTable;
use experiments::RunData;
use experiments::evaluation::mean;

/// Returns a table cell with a method's name, with a footnote if its settings are not those of the
/// preset of this name, and one for each run that is not finished.
pub(super) fn method_cell(table: &mut ReportTable, method: &MethodRuns) -> String {
    let unfinished = method.runs.iter().filter_map(unfinished_remark);
    let remarks = method.preset_match.warning.clone().into_iter().chain(unfinished);
    with_footnotes(table, &method.name, remarks)
}

/// Returns the notice that stands above a report on runs of the smoke budget; `None` without such
/// runs.
pub(super) fn smoke_test_notice(methods: &[MethodRuns]) -> Option<&'static str> {
    const NOTICE: &str = "These runs are as short as those of the smoke budget, which only tests that \
        the program works. Figures of such runs say nothing about the methods.";
    methods.iter().any(MethodRuns::is_smoke_test).then_some(NOTICE)
}

/// Adds footnotes to a table, and returns `name` followed by their marks.
pub(super) fn with_footnotes(
    table: &mut ReportTable,
    name: &str,
    remarks: impl Iterator<Item = String>,
) -> String {
    let marks = remarks.map(|remark| table.add_footnote(&remark));
    std::iter::once(name.to_owned()).chain(marks).collect::<Vec<_>>().join(" ")
}

/// Returns a footnote with the progress of an unfinished run; `None` for a finished one.
pub(super) fn unfinished_remark(run: &RunData) -> Option<String> {
    let decisions = run.rollouts.last().map_or(0, |row| row.decisions);
    let all = run.experiment.schedule.total_decisions();
    let scores = if run.scores.is_empty() {
        "was not evaluated yet"
    } else {
        "its scores are those of its last evaluation"
    };
    (!run.is_finished).then(|| {
        let name = &run.name;
        format!("{name} is not finished: it took {decisions} of {all} decisions, and {scores}")
    })
}

/// Returns the text of a mean score; if there is no score, so that the mean is NaN, says that there
/// was no evaluation.
pub(super) fn score_text(mean: f64, text: String) -> String {
    if mean.is_nan() { NOT_EVALUATED.to_owned() } else { text }
}

/// Returns a table cell with the mean over the seeds that have a metric; with a footnote if some
/// have none, and a dash and the reason if all have none.
pub(super) fn mean_cell(
    table: &mut ReportTable,
    metrics: &[Result<f64, UndefinedReason>],
) -> String {
    let known: Vec<f64> = metrics.iter().filter_map(|metric| metric.ok()).collect();
    let missing = metrics.iter().find_map(|metric| metric.err());
    match (known.is_empty(), missing) {
        (true, Some(reason)) => format!("- {}", table.add_footnote(reason)),
        (true, None) => empty_cell(),
        (false, None) => format!("{:.3}", mean(&known)),
        (false, Some(reason)) => {
            let (count, all) = (known.len(), metrics.len());
            let remark = format!("mean over {count} of {all} seeds; in the others, {reason}");
            format!("{:.3} {}", mean(&known), table.add_footnote(&remark))
        }
    }
}

/// Formats a confidence interval in brackets, to stand behind its estimate; empty if there is none,
/// or if it is a single point, as a bootstrap of equal values gives it.
pub(super) fn bracketed_interval(interval: Option<ConfidenceInterval>, digits: usize) -> String {
    let interval = interval.filter(|interval| interval.low < interval.high);
    interval.map_or_else(String::new, |ConfidenceInterval { low, high }| {
        format!(" [{low:.digits$}, {high:.digits$}]")
    })
}

/// Formats a p-value; a dash if there is none.
pub(super) fn p_value_cell(p_value: Option<f64>) -> String {
    match p_value {
        None => empty_cell(),
        Some(p_value) if p_value < 0.0001 => "< 0.0001".to_owned(),
        Some(p_value) => format!("{p_value:.4}"),
    }
}

/// Returns the dash that stands for a missing number in a table cell.
pub(super) fn empty_cell() -> String {
    "-".to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    #[test]
    fn a_mean_says_over_how_many_seeds_it_is() {
        let mut table = ReportTable::new("", &["method"]);
        let missing = Err("no group came back");
        assert_eq!(mean_cell(&mut table, &[Ok(0.25), Ok(0.75)]), "0.500");
        assert_eq!(mean_cell(&mut table, &[missing, missing]), "- (1)");
        assert_eq!(mean_cell(&mut table, &[Ok(0.25), missing]), "0.250 (2)");
        let remark = "mean over 1 of 2 seeds; in the others, no group came back";
        assert_eq!(table.footnotes, ["no group came back", remark]);
    }

    #[test]
    fn runs_of_the_smoke_budget_alone_have_a_notice() {
        let notice = |budget: Budget| {
            let mut experiment = budget.preset_experiment(Method::CoversSac).with_seed(3);
            experiment.evaluation.recognition_repeats = 7;
            let runs = vec![RunData::empty("covers-sac-seed3", experiment)];
            smoke_test_notice(&MethodRuns::group_by_method(runs).unwrap())
        };
        assert!(notice(Budget::Smoke).is_some());
        assert_eq!([Budget::Short, Budget::Full].map(notice), [None, None]);
    }
}

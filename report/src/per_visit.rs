//! Table of success in each group after each of its visits: methods that forget fall behind.

use super::format::{empty_cell, method_cell};
use super::method::MethodRuns;
use super::table::ReportTable;
use super::visits;
use experiments::RunData;
use experiments::evaluation::mean;

/// Returns the table of success in each group after each visit to it, means over runs. It has a row
/// for each method and a column for each group. `None` if no run was scored after a visit before
/// the end of its stream.
pub fn success_per_visit_table(methods: &[MethodRuns], groups: &[String]) -> Option<ReportTable> {
    let mut runs = methods.iter().flat_map(|method| &method.runs);
    // scores after the stream alone are in the table of results already
    if !runs.any(|run| groups.iter().any(|group| scored_within(run, group))) {
        return None;
    }
    let mut header = vec!["method"];
    header.extend(groups.iter().map(String::as_str));
    let caption = "Success in a group after each of its visits, at the end of the iteration in which \
        the visit ended, means over seeds and variants; after the last visit of the stream, in the \
        evaluation after the stream. Where not every run was scored then, there is none.";
    let mut table = ReportTable::new(caption, &header);
    for method in methods {
        let mut row = vec![method_cell(&mut table, method)];
        row.extend(groups.iter().map(|group| {
            let successes = method.runs.iter().map(|run| success_per_visit(run, group));
            cell(&mean_over_runs(&successes.collect::<Vec<_>>()))
        }));
        table.rows.push(row);
    }
    Some(table)
}

/// Returns `true` if a group was scored after one of its visits, before the stream was over.
fn scored_within(run: &RunData, group: &str) -> bool {
    visits::visit_end_rollouts(&run.rollouts, group)
        .into_iter()
        .any(|end| end < run.rollouts.len() && success(run, group, end).is_some())
}

/// Returns the success in a group after each visit of the stream to it; `None` for visits that no
/// evaluation followed.
fn success_per_visit(run: &RunData, group: &str) -> Vec<Option<f64>> {
    let ends = visits::visit_end_rollouts(&run.rollouts, group).into_iter();
    ends.map(|end| success(run, group, end)).collect()
}

fn success(run: &RunData, group: &str, rollouts: usize) -> Option<f64> {
    run.mean_group_score_after(rollouts, group, |row| row.success).map(|(_, success)| success)
}

/// Returns the mean success over runs after each visit to a group; `None` if a run lacks it.
fn mean_over_runs(runs: &[Vec<Option<f64>>]) -> Vec<Option<f64>> {
    let visits = runs.iter().map(Vec::len).max().unwrap_or(0);
    let mean_of = |visit: usize| {
        let successes: Option<Vec<f64>> =
            runs.iter().map(|run| run.get(visit).copied().flatten()).collect();
        successes.map(|successes| mean(&successes))
    };
    (0..visits).map(mean_of).collect()
}

fn cell(means: &[Option<f64>]) -> String {
    let format = |mean: &Option<f64>| mean.map_or_else(empty_cell, |mean| format!("{mean:.2}"));
    match means {
        [] => empty_cell(),
        _ => means.iter().map(format).collect::<Vec<_>>().join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::scored_run;

    #[test]
    fn a_visit_is_scored_where_it_ends() {
        let scores = [(0, 0.1), (1, 0.2), (2, 0.3), (3, 0.4), (6, 0.5)];
        let run = scored_run(&["a", "a", "b", "a", "a", "b"], &scores);
        assert_eq!(success_per_visit(&run, "a"), [Some(0.3), None]);
        assert_eq!(success_per_visit(&run, "b"), [None, None]);
        assert!(success_per_visit(&run, "c").is_empty());
    }

    #[test]
    fn there_is_a_table_where_a_run_was_scored_within_the_stream() {
        let table = |scores: &[(usize, f64)]| {
            let methods =
                MethodRuns::group_by_method(vec![scored_run(&["a", "b", "a"], scores)]).unwrap();
            super::success_per_visit_table(&methods, &["a".to_owned()]).map(|table| table.rows)
        };
        assert_eq!(table(&[(0, 0.1), (2, 0.2), (3, 0.5)]), None);
        let rows = table(&[(1, 0.25), (3, 0.5)]);
        assert_eq!(rows, Some(vec![vec!["covers".to_owned(), "0.25, 0.50".to_owned()]]));
    }

    #[test]
    fn what_a_run_lacks_has_no_mean() {
        let means = mean_over_runs(&[vec![Some(0.5), Some(1.0)], vec![Some(0.25)]]);
        assert_eq!(means, [Some(0.375), None]);
        assert_eq!((cell(&means), cell(&[])), ("0.38, -".to_owned(), "-".to_owned()));
    }
}

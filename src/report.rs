//! What a person reads: one line a rollout, and a table at the end.

use std::fmt::Write;

use crate::experiment::Summary;
use crate::progress::Progress;

/// The line of one rollout: decisions, true group, assigned policy (`new`, or `2nd` where it took a second rollout to recall it), mean
/// reward, success, W1 to each policy.
pub fn rollout_line(progress: &Progress) -> String {
    let report = &progress.report;
    let distances: Vec<String> = report
        .evidence
        .iter()
        .map(|evidence| match evidence.score() {
            Some(score) => format!("{:.2} (z {score:.1})", evidence.distance),
            None => format!("{:.2}", evidence.distance),
        })
        .collect();
    let remark = match (report.created, &report.first_look) {
        (true, _) => " new",
        (false, Some(_)) => " 2nd",
        (false, None) => "    ",
    };
    format!(
        "{:>7}  {:<12}  policy {}{remark}  reward {:>5}  success {:>4}  W1 [{}]",
        progress.decisions,
        progress.group.name(),
        report.policy,
        number(progress.reward, 1),
        number(progress.success, 2),
        distances.join(", "),
    )
}

/// A figure with `digits` decimals; a dash where there is none.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// The table of a whole run.
pub fn summary_table(summary: &Summary) -> String {
    let mut table = String::from(
        "group         policy  episodes  success  at end  reward of 500\n\
         ------------  ------  --------  -------  ------  -------------\n",
    );
    for score in &summary.groups {
        // writing to a String cannot fail
        let _ = writeln!(
            table,
            "{:<12}  {:>6}  {:>8}  {:>7.2}  {:>6.2}  {:>13.1}",
            score.group,
            score.policy,
            score.episodes,
            score.success,
            score.success_at_end,
            score.reward
        );
    }
    let _ = write!(
        table,
        "assignment accuracy {:.3}, {} policies, {} decisions in {:.0} s ({:.0} per second)",
        summary.assignment_accuracy,
        summary.policies,
        summary.decisions,
        summary.seconds,
        summary.decisions_per_second
    );
    if summary.failures > 0 {
        let _ = write!(table, ", {} failures of environments", summary.failures);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_of_environments_are_mentioned_where_there_were_any() {
        let mut summary = Summary {
            decisions: 100,
            seconds: 2.0,
            decisions_per_second: 50.0,
            policies: 1,
            failures: 0,
            assignment_accuracy: 1.0,
            groups: Vec::new(),
        };
        assert!(!summary_table(&summary).contains("failures"));
        summary.failures = 3;
        assert!(summary_table(&summary).ends_with(", 3 failures of environments"));
    }
}

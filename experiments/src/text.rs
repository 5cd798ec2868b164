//! Text for the terminal: one line per rollout, and tables of scores.

use std::fmt::{self, Write};

use crate::evaluation::{VariantScore, average_scores_by_group};
use crate::{RolloutReport, RunEvent, RunSummary};

/// Line of column names, printed above the lines of [`format_rollout_line`].
pub const ROLLOUT_LINE_HEADER: &str =
    "decisions  group         policy      reward  success  distance (z) per policy";

/// Formats an event of a run for the terminal: a line for a rollout, a table for an evaluation.
pub fn format_run_event(event: &RunEvent) -> String {
    match event {
        RunEvent::Rollout(progress) => format_rollout_line(progress),
        RunEvent::Evaluation(evaluation) => score_table(&evaluation.results.scores),
    }
}

/// Formats a rollout as one line: decisions so far, true group at its start, assigned policy
/// (`new`, or `2nd` if no policy trained on an earlier rollout of the iteration), mean reward,
/// success, and distance to each compared policy with its standard score.
pub fn format_rollout_line(progress: &RolloutReport) -> String {
    let iteration = &progress.iteration;
    let evidence = iteration.evidence.iter();
    let line = RolloutLine {
        decisions: progress.decisions,
        group: progress.group.name(),
        policy: iteration.policy,
        policy_created: iteration.policy_created,
        needed_second_rollout: iteration.discarded > 0,
        reward: progress.scaled_mean_return(),
        success: progress.success_rate(),
        distances_and_z_scores: evidence
            .map(|evidence| (Some(evidence.distance), evidence.test_score()))
            .collect(),
    };
    line.to_string()
}

/// Values of the line that a terminal shows about one rollout; `Display` formats it.
pub struct RolloutLine<'a> {
    /// Number of decisions of the run by the end of the rollout.
    pub decisions: usize,
    /// Name of the task group at the start of the rollout.
    pub group: &'a str,
    /// Index of the policy that the rollout was assigned to.
    pub policy: usize,
    /// `true` if the policy was created for the rollout.
    pub policy_created: bool,
    /// `true` if a second rollout was needed to choose the policy.
    pub needed_second_rollout: bool,
    /// Mean return of the ended episodes on the paper's scale, in `[0, 500]`; `None` if no episode
    /// ended.
    pub reward: Option<f64>,
    /// Share of ended episodes that succeeded, in `[0, 1]`; `None` if no episode ended.
    pub success: Option<f64>,
    /// Distance of the rollout to each compared policy, and its standard score under permutation.
    pub distances_and_z_scores: Vec<(Option<f64>, Option<f64>)>,
}

impl fmt::Display for RolloutLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let evidence = self.distances_and_z_scores.iter().map(|&(distance, score)| match score {
            Some(score) => format!("{} ({score:.1})", format_number(distance, 2)),
            None => format_number(distance, 2),
        });
        // four columns wide, so that the columns behind it stay aligned
        let remark = match (self.policy_created, self.needed_second_rollout) {
            (true, _) => " new",
            (false, true) => " 2nd",
            (false, false) => "    ",
        };
        let line = format!(
            "{:>9}  {:<12}  {:>6}{remark}  {:>6}  {:>7}  {}",
            self.decisions,
            self.group,
            self.policy,
            format_number(self.reward, 1),
            format_number(self.success, 2),
            evidence.collect::<Vec<_>>().join(", "),
        );
        f.write_str(line.trim_end())
    }
}

/// Formats a number with `digits` decimals; `-` for `None` and for non-finite numbers.
pub fn format_number(value: Option<f64>, digits: usize) -> String {
    let finite = value.filter(|value| value.is_finite());
    finite.map_or_else(|| "-".to_owned(), |shown| format!("{shown:.digits$}"))
}

/// Formats the scores of one evaluation as a table with a line for each group; held-out variants
/// stand in brackets. Further lines name groups of which the learner played a variant with another
/// policy than the group's own.
pub fn score_table(scores: &[VariantScore]) -> String {
    let groups = average_scores_by_group(scores);
    let names = groups.iter().map(|group| group.group.name().len());
    let width = names.max().unwrap_or(0).max("group".len());
    // an evaluation plays all groups alike
    let episodes = groups.first().map_or(0, |group| group.episodes);
    let mut table = format!(
        "{episodes} episodes of each group: success at any time, at the end, reward of 500\n\
         {:<width$} policy success  end reward identity flip x flip y half turn\n\
         {:-<width$} ------ ------- ---- ------ -------- ------ ------ ---------",
        "group", "",
    );
    for group in &groups {
        let policies: Vec<String> = group.policies.iter().map(usize::to_string).collect();
        // writing to a String cannot fail
        let _ = write!(
            table,
            "\n{:<width$} {:>6} {:>7.2} {:>4.2} {:>6.1}",
            group.group.name(),
            policies.join(","),
            group.success,
            group.success_at_end,
            group.reward
        );
        let variants = scores.iter().filter(|score| score.group == group.group);
        for (score, columns) in variants.zip([8, 6, 6, 9]) {
            let success = if score.seen_in_training {
                format!("{:.2}", score.success)
            } else {
                format!("({:.2})", score.success)
            };
            let _ = write!(table, " {success:>columns$}");
        }
    }
    for group in groups.iter().filter(|group| group.mismatches > 0) {
        let variants = scores.iter().filter(|score| score.group == group.group);
        let _ = write!(
            table,
            "\n{}: {} of {} variants were played by another policy than the group's own",
            group.group.name(),
            group.mismatches,
            variants.count(),
        );
        if let Some(own) = group.own_policy_score {
            let _ = write!(
                table,
                "; policy {}, its own, has success {:.2}, at end {:.2}, reward {:.1}",
                own.policy, own.success, own.success_at_end, own.reward
            );
        }
    }
    table
}

/// Formats the summary of a run as a table of scores and a line of totals.
pub fn run_summary_table(summary: &RunSummary) -> String {
    let mut table = score_table(&summary.variants);
    let _ = write!(
        table,
        "\nassignment accuracy {}{}, {} policies, {} decisions in {:.0} s ({} per second)",
        format_number(summary.assignment_accuracy, 3),
        summary
            .revisit_accuracy
            .map_or_else(String::new, |accuracy| format!(" ({accuracy:.3} when groups come back)")),
        summary.policies,
        summary.decisions,
        summary.seconds,
        format_number(summary.decisions_per_second, 0),
    );
    if summary.merged_policies > 0 {
        let _ = write!(table, ", {} policies merged into others", summary.merged_policies);
    }
    if summary.switch_rollouts > 0 {
        let number = summary.switch_rollouts;
        let plural = if number == 1 { "" } else { "s" };
        let _ = write!(table, ", {number} rollout{plural} of two groups");
    }
    if summary.environment_failures > 0 {
        let _ = write!(table, ", {} failures of environments", summary.environment_failures);
    }
    table
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use envs::TaskGroup;
    use symmetry::D2;

    use super::*;
    use crate::evaluation::PolicyScore;

    #[test]
    fn failures_and_merges_are_mentioned_where_there_were_any() {
        let mut summary = RunSummary {
            decisions: 100,
            seconds: 2.0,
            decisions_per_second: Some(50.0),
            policies: 1,
            merged_policies: 0,
            environment_failures: 0,
            switch_rollouts: 0,
            assignment_accuracy: Some(1.0),
            revisit_accuracy: None,
            groups: Vec::new(),
            variants: Vec::new(),
            table_checksums: BTreeMap::new(),
        };
        assert!(!run_summary_table(&summary).contains("failures"));
        summary.environment_failures = 3;
        assert!(run_summary_table(&summary).ends_with(", 3 failures of environments"));
        summary.merged_policies = 2;
        assert!(
            run_summary_table(&summary).contains(", 2 policies merged into others, 3 failures")
        );
    }

    #[test]
    fn held_out_variants_stand_in_brackets() {
        let scores = D2::ALL.map(|element| VariantScore {
            group: TaskGroup::BUTTON_PRESS_TOPDOWN,
            element,
            seen_in_training: element == D2::Identity,
            policy: 2,
            episodes: 20,
            success: 0.95,
            success_at_end: 0.5,
            reward: 312.0,
            own_policy_score: None,
        });
        let table = score_table(&scores);
        let row: Vec<&str> = table.lines().nth(3).unwrap().split_whitespace().collect();
        let expected = "button-press-topdown 2 0.95 0.50 312.0 0.95 (0.95) (0.95) (0.95)";
        assert_eq!(row.join(" "), expected);
        assert!(table.lines().all(|line| line.len() <= 80), "{table}");
    }

    #[test]
    fn another_groups_policy_is_mentioned_where_one_played() {
        let own = PolicyScore { policy: 1, success: 0.9, success_at_end: 0.8, reward: 400.0 };
        let with = |policy| {
            let own = Some(own);
            let scores = D2::ALL.map(|element| VariantScore {
                group: TaskGroup::PLATE_SLIDE,
                element,
                seen_in_training: true,
                policy: if element == D2::FlipX { policy } else { 1 },
                episodes: 20,
                success: 0.5,
                success_at_end: 0.5,
                reward: 200.0,
                own_policy_score: own,
            });
            score_table(&scores)
        };
        let (right, wrong) = (with(1), with(0));
        assert_eq!(right.lines().count(), 4, "{right}");
        assert_eq!(wrong.lines().count(), 5, "{wrong}");
        let expected = "plate-slide: 1 of 4 variants were played by another policy than the \
            group's own; policy 1, its own, has success 0.90, at end 0.80, reward 400.0";
        assert_eq!(wrong.lines().last(), Some(expected));
    }
}

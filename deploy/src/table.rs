//! Table of a deployment's success, in the form of the paper's table.

use std::collections::BTreeMap;

use envs::TaskGroup;
use serde::Serialize;
use symmetry::D2;

use itertools::Itertools;
use report::ReportTable;

/// Success rate of the paper's policies on a real Kinova Gen3 in 20 trials of each task group (Liu
/// et al., CoRL 2023, section 5).
const PAPER: [(&str, f64); 4] =
    [("plate-slide", 0.45), ("button-press", 0.60), ("drawer-close", 0.65), ("goal-reach", 0.95)];
/// Half width of a 95 % confidence interval in standard deviations of the normal distribution.
const DEVIATIONS: f64 = 1.959_963_984_540_054;

/// Result of one trial of a policy on a robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrialResult {
    /// Task group whose scene was built for this trial.
    pub group: TaskGroup,
    /// Element of D2 by which the scene was transformed.
    pub element: D2,
    /// Index of the trial among those of the variant, from 0.
    #[serde(rename = "number")]
    pub trial_index: usize,
    /// Index of the policy that the learner chose from the first picture.
    pub policy: usize,
    /// `true` if the learner considered the policy to match the group.
    #[serde(rename = "fits")]
    pub policy_fits: bool,
    /// `true` if the task was solved at any time of the trial.
    pub success: bool,
    /// `true` if the task was solved at the end of the trial.
    pub success_at_end: bool,
    /// Number of commands in the trial that the arm refused because it could not follow them.
    #[serde(rename = "refused")]
    pub refused_commands: usize,
}

/// Returns the 95 % confidence interval of a success rate by Wilson's score ("Probable inference,
/// the law of succession, and statistical inference", JASA 22, 1927); `[0, 1]` without trials.
pub(super) fn wilson_interval(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let (n, z) = (trials as f64, DEVIATIONS);
    let share = successes as f64 / n;
    let middle = share + z * z / (2.0 * n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    [-1.0, 1.0].map(|side| ((middle + side * half) / (1.0 + z * z / n)).clamp(0.0, 1.0))
}

/// Returns a table (text) with a row for each group: success with its interval, success at the end,
/// the success that the paper reports for its real arm, and the policies that were chosen.
pub fn trial_success_table(scores: &[TrialResult]) -> String {
    table(scores).text()
}

/// Returns the table of success in each task group, [`trial_success_table`], in Markdown.
pub(super) fn deployment_markdown(scores: &[TrialResult]) -> String {
    table(scores).markdown()
}

fn table(scores: &[TrialResult]) -> ReportTable {
    let header =
        ["group", "trials", "success", "95 % interval", "at end", "paper, real arm", "policies"];
    let mut table = ReportTable::new("Success in trials on a robot.", &header);
    let groups: Vec<_> = scores.iter().map(|score| score.group).unique().collect();
    for &group in &groups {
        let of = scores.iter().filter(|score| score.group == group);
        let paper = PAPER.iter().find(|(name, _)| *name == group.name());
        let paper = paper.map(|(_, success)| *success);
        table.rows.push(row(group.name(), &of.collect::<Vec<_>>(), paper));
    }
    // the paper's average is over its four groups, so it compares with all of them only
    let is_known = |(name, _): &(&str, f64)| groups.iter().any(|group| group.name() == *name);
    let are_papers = groups.len() == PAPER.len() && PAPER.iter().all(is_known);
    let all = are_papers.then(|| {
        let known = PAPER.iter().map(|(_, success)| success);
        known.sum::<f64>() / PAPER.len() as f64
    });
    let scores: Vec<_> = scores.iter().collect();
    table.rows.push(row("all", &scores, all));
    table
}

fn row(name: &str, scores: &[&TrialResult], paper: Option<f64>) -> Vec<String> {
    let trials = scores.len();
    let share = |holds: fn(&TrialResult) -> bool| {
        let count = scores.iter().filter(|score| holds(score)).count();
        (count, count as f64 / trials.max(1) as f64)
    };
    let (successes, success) = share(|score| score.success);
    let (_, at_end) = share(|score| score.success_at_end);
    let [low, high] = wilson_interval(successes, trials);
    vec![
        name.to_owned(),
        trials.to_string(),
        format!("{success:.2}"),
        format!("{low:.2} to {high:.2}"),
        format!("{at_end:.2}"),
        paper.map_or_else(|| "-".to_owned(), |reported| format!("{reported:.2}")),
        policies(scores),
    ]
}

/// Header (CSV) of the columns of [`trial_csv_row`].
pub(super) const TRIAL_CSV_HEADER: &str =
    "group,variant,number,policy,fits,success,success_at_end,refused";

/// Formats a trial as a row (CSV) without a line break.
pub(super) fn trial_csv_row(score: &TrialResult) -> String {
    format!(
        "{},{},{},{},{},{},{},{}",
        score.group.name(),
        score.element,
        score.trial_index,
        score.policy,
        u8::from(score.policy_fits),
        u8::from(score.success),
        u8::from(score.success_at_end),
        score.refused_commands
    )
}

/// Returns a table (CSV) of the results of trials, a row for each.
pub(super) fn trials_csv(scores: &[TrialResult]) -> String {
    let rows = scores.iter().map(|score| trial_csv_row(score) + "\n");
    format!("{TRIAL_CSV_HEADER}\n{}", rows.collect::<String>())
}

/// Lists the chosen policies, each with its number of trials.
fn policies(scores: &[&TrialResult]) -> String {
    let mut chosen: BTreeMap<usize, usize> = BTreeMap::new();
    for score in scores {
        *chosen.entry(score.policy).or_default() += 1;
    }
    let chosen: Vec<String> =
        chosen.into_iter().map(|(policy, times)| format!("{policy} ({times})")).collect();
    chosen.join(", ")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns the score of a trial with policy 1 and two refused commands.
    pub fn score(group: TaskGroup, trial_index: usize, success: bool) -> TrialResult {
        TrialResult {
            group,
            element: D2::FlipX,
            trial_index,
            policy: 1,
            policy_fits: true,
            success,
            success_at_end: false,
            refused_commands: 2,
        }
    }

    #[test]
    fn intervals_are_wilsons() {
        // statsmodels.stats.proportion.proportion_confint(k, n, method="wilson")
        for (successes, trials, expected) in
            [(9, 20, [0.258_2, 0.657_9]), (20, 20, [0.838_9, 1.0]), (0, 5, [0.0, 0.434_5])]
        {
            let interval = wilson_interval(successes, trials);
            for (bound, limit) in interval.into_iter().zip(expected) {
                assert!((bound - limit).abs() < 5e-4, "{interval:?}");
            }
        }
        assert_eq!(wilson_interval(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn a_group_has_a_line_with_its_policies_and_the_papers_figure() {
        let score = |group, number, success| TrialResult {
            policy: 2 + number / 3,
            ..score(group, number, success)
        };
        let mut scores: Vec<_> =
            (0..4).map(|number| score(TaskGroup::PLATE_SLIDE, number, number > 0)).collect();
        // between the trials of the other group
        scores.insert(2, score(TaskGroup::GOAL_REACH, 0, true));
        let table = trial_success_table(&scores);
        let lines: Vec<Vec<&str>> = table.lines().map(|l| l.split_whitespace().collect()).collect();
        let expected = "plate-slide 4 0.75 0.30 to 0.95 0.00 0.45 2 (3), 3 (1)";
        assert_eq!(lines[2].join(" "), expected);
        assert_eq!(lines[3][..3], ["goal-reach", "1", "1.00"]);
        assert_eq!(lines[4][..3], ["all", "5", "0.80"]);
        assert_eq!(lines[4][7], "-", "two groups of four");
        assert_eq!(trials_csv(&scores).lines().count(), 1 + scores.len());
        let foreign =
            [TaskGroup::PUSH, TaskGroup::PICK_PLACE, TaskGroup::DOOR_OPEN, TaskGroup::WINDOW_OPEN];
        for (groups, paper) in [(TaskGroup::STANDARD, "0.66"), (foreign, "-")] {
            let solved: Vec<_> = groups.iter().map(|&group| score(group, 0, true)).collect();
            let all = trial_success_table(&solved);
            let words: Vec<&str> = all.lines().last().unwrap().split_whitespace().collect();
            assert_eq!((words[0], words[7]), ("all", paper), "{all}");
        }
    }
}

//! Rows of small runs, for tests.

use experiments::presets::{Budget, Method};
use experiments::{RecognitionRow, RolloutRow, RunData, ScoreRow};
use symmetry::D2;

/// Returns rollouts of 100 decisions each in these groups, with the policies that served them; `*`
/// marks a rollout that ends in the next one's group.
pub fn rollouts(rows: &[(&str, usize)]) -> Vec<RolloutRow> {
    let name = |index: usize| rows[index].0.trim_end_matches('*').to_owned();
    let row = |(index, &(group, policy)): (usize, &(&str, usize))| {
        let spans_switch = group.ends_with('*');
        RolloutRow {
            decisions: 100 * (index + 1),
            group: name(index),
            last_group: name((index + usize::from(spans_switch)).min(rows.len() - 1)),
            spans_switch,
            policy,
            ..RolloutRow::default()
        }
    };
    rows.iter().enumerate().map(row).collect()
}

/// Returns a run of a method with these rollouts, see [`rollouts`].
pub fn run(method: Method, rows: &[(&str, usize)]) -> RunData {
    let name = format!("{}-seed0", method.name());
    let empty = RunData::empty(&name, Budget::Smoke.preset_experiment(method));
    RunData { rollouts: rollouts(rows), ..empty }
}

/// Returns a run of one policy in these groups, with its success in group `a` after some of its
/// rollouts.
pub fn scored_run(groups: &[&str], scores: &[(usize, f64)]) -> RunData {
    let rows: Vec<_> = groups.iter().map(|&group| (group, 0)).collect();
    let scores = scores.iter().map(|&(rollouts, success)| score(rollouts, "a", success));
    RunData { scores: scores.collect(), ..run(Method::Covers, &rows) }
}

/// Returns the score of a group's identity variant after this many rollouts, over ten episodes.
pub fn score(rollouts: usize, group: &str, success: f64) -> ScoreRow {
    ScoreRow {
        rollouts,
        decisions: 100 * rollouts,
        group: group.to_owned(),
        element: D2::Identity.to_string(),
        seen_in_training: true,
        episodes: 10,
        success,
        success_at_end: success,
        ..ScoreRow::default()
    }
}

/// Returns the number of times that a learner named a policy for these many episodes of a group.
pub fn answer(
    &(group, episodes_shown, policy, count): &(&str, usize, Option<usize>, usize),
) -> RecognitionRow {
    let (group, element) = (group.to_owned(), D2::Identity.to_string());
    RecognitionRow { group, element, episodes_shown, policy, count }
}

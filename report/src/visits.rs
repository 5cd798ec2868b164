//! Task groups of a run, and ends of the visits to a group.

use std::iter::repeat_n;

use experiments::{RolloutRow, RunData};
use itertools::Itertools;

/// Returns the names of a run's task groups: those of its last evaluation, or those of its rollouts
/// if it was not evaluated yet.
pub fn groups_of_run(run: &RunData) -> Vec<&str> {
    let scored = run.scored_groups();
    if !scored.is_empty() {
        return scored;
    }
    run.rollouts.iter().map(|row| row.group.as_str()).unique().collect()
}

/// Returns, for each visit to a task group, the number of rollouts of the run when it was over. The
/// rows hold the first and the last group of a rollout alone, so a visit within one rollout that
/// neither began nor ended it is missing.
pub fn visit_end_rollouts(rollouts: &[RolloutRow], group: &str) -> Vec<usize> {
    let over = |index: usize| {
        let row = &rollouts[index];
        let next = rollouts.get(index + 1).map(|later| later.group.as_str());
        let first = row.group == group && (row.spans_switch || next != Some(group));
        // the group came within the rollout, and the next rollout has another one
        let last = row.spans_switch && row.last_group == group && next != Some(group);
        repeat_n(index + 1, usize::from(first) + usize::from(last))
    };
    (0..rollouts.len()).flat_map(over).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the ends of `a` in rollouts that are written as the groups they showed.
    fn ends_of_a(rollouts: &[&str]) -> Vec<usize> {
        let row = |groups: &&str| RolloutRow {
            group: groups[..1].to_owned(),
            last_group: groups[groups.len() - 1..].to_owned(),
            spans_switch: groups.len() > 1,
            ..RolloutRow::default()
        };
        visit_end_rollouts(&rollouts.iter().map(row).collect::<Vec<_>>(), "a")
    }

    #[test]
    fn a_visit_ends_where_another_group_comes_or_the_stream_ends() {
        assert_eq!(ends_of_a(&["a", "a", "b", "a"]), [2, 4]);
        assert_eq!(ends_of_a(&["a", "ab", "b", "ba", "a", "b"]), [2, 5]);
        assert!(ends_of_a(&["b"]).is_empty());
    }

    #[test]
    fn short_visits_count_where_a_rollout_begins_or_ends_with_them() {
        // there is another group within a rollout
        assert_eq!(ends_of_a(&["a", "aba", "a"]), [2, 3]);
        // the whole visit is within a rollout
        assert_eq!(ends_of_a(&["b", "ba", "c"]), [2]);
        assert_eq!(ends_of_a(&["b", "ba"]), [2]);
        // one visit ends within the rollout and one with it
        assert_eq!(ends_of_a(&["aba", "c"]), [1, 1]);
    }
}

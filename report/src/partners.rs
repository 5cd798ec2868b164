//! Which policy belongs to which group.

use experiments::{RolloutRow, acting};

/// The policy that acts for the group of `policy` after the last of these rollouts.
pub fn last_acting(rollouts: &[RolloutRow], policy: usize) -> usize {
    let last = rollouts.last();
    last.map_or(policy, |row| acting(&row.heirs, policy))
}

/// The policy that belongs to a group: one that served it in most of its rollouts, where no other
/// policy served the group in more; of equals the first. A policy counts as the one that acts for
/// its group in the end. Rollouts within which the group changed count for nobody.
pub fn partner(rollouts: &[RolloutRow], group: &str) -> Option<usize> {
    let policies = rollouts.iter().map(|row| row.policy + 1).max()?;
    let served = |policy, group: &str| {
        let own = rollouts.iter().filter(|row| !row.straddles);
        let own = own.filter(|row| row.group == group);
        own.filter(|row| last_acting(rollouts, row.policy) == policy).count()
    };
    // the last of equals in the reversed order is the first
    let most = (0..policies).rev().max_by_key(|&policy| served(policy, group))?;
    let mut others = rollouts.iter().map(|row| row.group.as_str());
    let own = served(most, group);
    (own > 0 && others.all(|other| served(most, other) <= own)).then_some(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rollouts of groups, the policy of each; `*` marks those that straddle.
    fn rollouts(rows: &[(&str, usize)]) -> Vec<RolloutRow> {
        let row = |&(group, policy): &(&str, usize)| RolloutRow {
            group: group.trim_end_matches('*').to_owned(),
            straddles: group.ends_with('*'),
            policy,
            ..RolloutRow::default()
        };
        rows.iter().map(row).collect()
    }

    #[test]
    fn a_policy_belongs_to_the_group_that_it_served_most() {
        let rows = rollouts(&[("a", 0), ("a", 0), ("b", 0), ("b", 1), ("b", 1), ("c*", 2)]);
        let of = |group| partner(&rows, group);
        assert_eq!(["a", "b", "c", "d"].map(of), [Some(0), Some(1), None, None]);
    }

    #[test]
    fn a_group_whose_policy_serves_another_one_more_has_none() {
        let rows = rollouts(&[("a", 0), ("a", 0), ("a", 0), ("b", 0), ("b", 0), ("b", 1)]);
        assert_eq!(["a", "b"].map(|group| partner(&rows, group)), [Some(0), None]);
        let equal = rollouts(&[("a", 1), ("b", 0), ("a", 0), ("b", 1)]);
        assert_eq!(["a", "b"].map(|group| partner(&equal, group)), [Some(0); 2]);
        assert_eq!(partner(&[], "a"), None);
    }

    /// What counts is who acts in the end.
    #[test]
    fn an_heir_goes_on_for_the_group_of_its_policy() {
        let mut rows = rollouts(&[("a", 0), ("a", 0), ("b", 1), ("a", 2)]);
        let of = |rows: &[RolloutRow]| ["a", "b"].map(|group| partner(rows, group));
        rows[2].heirs = vec![Some(1), None];
        assert_eq!(of(&rows), [Some(0), Some(1)]);
        rows[3].heirs = vec![Some(2), None, None];
        assert_eq!(of(&rows), [Some(2), Some(1)]);
    }
}

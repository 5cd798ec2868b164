//! Matching of policies to groups by the rollouts that they served.

use experiments::{RolloutRow, surviving_policy};

/// Returns the policy that `policy` was merged into by the end of `rollouts`, or `policy` itself if
/// it was not merged.
pub fn policy_after_merges(rollouts: &[RolloutRow], policy: usize) -> usize {
    let last = rollouts.last();
    last.map_or(policy, |row| surviving_policy(&row.merged_into, policy))
}

/// Returns the policy that belongs to a group: the one that served the group in most of its
/// rollouts, on a tie the first; `None` if it served another group in more rollouts, or if no
/// policy served the group.
///
/// Merged policies count as one. Rollouts within which the group changed are left out.
pub fn own_policy_of_group(rollouts: &[RolloutRow], group: &str) -> Option<usize> {
    let policies = rollouts.iter().map(|row| row.policy + 1).max()?;
    let served = |policy, name: &str| {
        let of_group = rollouts.iter().filter(|row| !row.spans_switch && row.group == name);
        of_group.filter(|row| policy_after_merges(rollouts, row.policy) == policy).count()
    };
    // `max_by_key` returns the last of equals: in reversed order, that is the first policy
    let most = (0..policies).rev().max_by_key(|&policy| served(policy, group))?;
    let mut others = rollouts.iter().map(|row| row.group.as_str());
    let own = served(most, group);
    (own > 0 && others.all(|other| served(most, other) <= own)).then_some(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::rollouts;

    #[test]
    fn a_policy_belongs_to_the_group_that_it_served_most() {
        let rows = rollouts(&[("a", 0), ("a", 0), ("b", 0), ("b", 1), ("b", 1), ("c*", 2)]);
        let of = |group| own_policy_of_group(&rows, group);
        assert_eq!(["a", "b", "c", "d"].map(of), [Some(0), Some(1), None, None]);
    }

    #[test]
    fn a_group_whose_policy_serves_another_one_more_has_none() {
        let rows = rollouts(&[("a", 0), ("a", 0), ("a", 0), ("b", 0), ("b", 0), ("b", 1)]);
        assert_eq!(["a", "b"].map(|group| own_policy_of_group(&rows, group)), [Some(0), None]);
        let equal = rollouts(&[("a", 1), ("b", 0), ("a", 0), ("b", 1)]);
        assert_eq!(["a", "b"].map(|group| own_policy_of_group(&equal, group)), [Some(0); 2]);
        assert_eq!(own_policy_of_group(&[], "a"), None);
    }

    #[test]
    fn an_heir_goes_on_for_the_group_of_its_policy() {
        let mut rows = rollouts(&[("a", 0), ("a", 0), ("b", 1), ("a", 2)]);
        let of = |table: &[RolloutRow]| ["a", "b"].map(|group| own_policy_of_group(table, group));
        rows[2].merged_into = vec![Some(1), None];
        assert_eq!(of(&rows), [Some(0), Some(1)]);
        rows[3].merged_into = vec![Some(2), None, None];
        assert_eq!(of(&rows), [Some(2), Some(1)]);
    }
}

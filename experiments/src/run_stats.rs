//! Statistics of assignments: the group of each policy, and the rollouts that went to the right
//! one.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::evaluation::OwnPolicies;
use crate::schema::RolloutRow;

/// Number of rollouts by group and by the policy that served it, without rollouts that span a task
/// switch.
pub type Served = BTreeMap<String, BTreeMap<usize, usize>>;

/// Statistics of a run from the ground-truth groups, which the learner does not see.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunStats {
    /// Group that each policy was created for: the group of its first rollout without a task
    /// switch; `None` before such a rollout.
    pub opened_for: Vec<Option<String>>,
    /// For each policy, the one that it was merged into, as of the last iteration
    /// ([`learner::Iteration::merged_into`]). `right` and own policies count a merged policy as the
    /// one that acts for it.
    #[serde(default, rename = "heirs")]
    pub merged_into: Vec<Option<usize>>,
    /// Number of rollouts by task group and by the policy that served it, without those that span a
    /// task switch. Checkpoints leave them out, since the rows of `metrics.csv` in the checkpoint
    /// hold them.
    #[serde(skip)]
    pub served: Served,
    /// Number of rollouts trained on, including those that span a task switch.
    pub rollouts: usize,
    /// Number of decisions taken in training.
    pub decisions: usize,
    /// Number of rollouts that span a task switch. They have no right policy, so accuracies leave
    /// them out.
    #[serde(rename = "straddled")]
    pub spanning_switch: usize,
    /// Number of rollouts without a task switch that were assigned to the policy of their group. It
    /// is the first policy created for the group, or the one that policy was merged into, unless it
    /// belongs to another group.
    pub right: usize,
    /// Number of rollouts of groups that were visited before, without a task switch.
    pub returns: usize,
    /// Number of rollouts of groups that were visited before, without a task switch, assigned to
    /// the policy of their group.
    pub right_returns: usize,
    /// Number of failures of single environments in training, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Wall-clock seconds of training, without evaluations. Checkpoints leave them out, so that
    /// equal runs give equal checkpoints.
    #[serde(skip)]
    pub seconds: f64,
}

impl RunStats {
    /// Computes the statistics of a run after these rollouts.
    pub fn of(rollouts: &[RolloutRow]) -> Self {
        let mut stats = Self::default();
        let mut left: Vec<&str> = Vec::new();
        for (index, row) in rollouts.iter().enumerate() {
            if let Some(before) = index.checked_sub(1).map(|before| &rollouts[before])
                && (before.spans_switch || before.group != row.group)
            {
                left.push(&before.group);
                // a visit can end within the rollout that it began in
                if before.last_group != row.group {
                    left.push(&before.last_group);
                }
            }
            if row.spans_switch {
                stats.record_task_switch(row.policy);
            } else {
                stats.record(&row.group, left.contains(&row.group.as_str()), row.policy);
            }
            stats.record_merges(&row.merged_into);
        }
        stats
    }

    /// Records the merges of policies after an iteration.
    pub(crate) fn record_merges(&mut self, merged_into: &[Option<usize>]) {
        self.merged_into = merged_into.to_vec();
    }

    /// Returns the number of policies that were merged into others.
    pub fn merged(&self) -> usize {
        self.merged_into.iter().flatten().count()
    }

    /// Records one rollout of one group; `returns` is `true` if the group was visited before.
    pub(crate) fn record(&mut self, group: &str, returns: bool, policy: usize) {
        self.open(policy);
        self.opened_for[policy].get_or_insert_with(|| group.to_owned());
        count_served(&mut self.served, group, policy);
        let own = acting_policy(&self.merged_into, policy);
        let right = usize::from(self.policy_of(group) == Some(own));
        self.rollouts += 1;
        self.right += right;
        if returns {
            self.returns += 1;
            self.right_returns += right;
        }
    }

    /// Records one rollout that spans a task switch.
    pub(crate) fn record_task_switch(&mut self, policy: usize) {
        self.open(policy);
        self.rollouts += 1;
        self.spanning_switch += 1;
    }

    /// Returns the policy that served each task group in most of its rollouts; the lowest index
    /// wins ties. Merged policies count as the policy that acts for them, and groups may share one.
    pub fn own_policies(&self) -> OwnPolicies {
        let own = |(group, served): (&String, &BTreeMap<usize, usize>)| {
            let mut acted: BTreeMap<usize, usize> = BTreeMap::new();
            for (&policy, &rollouts) in served {
                *acted.entry(acting_policy(&self.merged_into, policy)).or_default() += rollouts;
            }
            let most =
                acted.into_iter().max_by_key(|&(policy, rollouts)| (rollouts, Reverse(policy)))?;
            Some((group.clone(), most.0))
        };
        self.served.iter().filter_map(own).collect()
    }

    /// Returns the policy that acts for a group; `None` without one, or if it also acts for an
    /// earlier group.
    fn policy_of(&self, group: &str) -> Option<usize> {
        let is_own = |opened: &Option<String>| opened.as_deref() == Some(group);
        let first = self.opened_for.iter().position(is_own)?;
        let own = acting_policy(&self.merged_into, first);
        // `own` may act for an earlier policy, whose group then has the better claim to it
        let is_others = |policy: usize| {
            self.opened_for[policy].is_some() && acting_policy(&self.merged_into, policy) == own
        };
        (!(0..first).any(is_others)).then_some(own)
    }

    /// Returns `true` if the counts are consistent: no part exceeds its whole, and every rollout
    /// has decisions.
    pub(crate) fn adds_up(&self) -> bool {
        let of_one_group = self.rollouts.checked_sub(self.spanning_switch);
        self.decisions >= self.rollouts
            && self.merged() <= self.opened_for.len()
            && of_one_group.is_some_and(|of_one| self.right.max(self.returns) <= of_one)
            && self.right_returns <= self.right.min(self.returns)
    }

    fn open(&mut self, policy: usize) {
        let policies = self.opened_for.len().max(policy + 1);
        self.opened_for.resize(policies, None);
    }

    /// Returns the share of rollouts assigned to the policy of their group, in `[0, 1]`; `None` if
    /// all rollouts span a task switch.
    pub fn accuracy(&self) -> Option<f64> {
        share(self.right, self.rollouts - self.spanning_switch)
    }

    /// Returns the assignment accuracy over rollouts of groups that were visited before; `None`
    /// without any.
    pub fn return_accuracy(&self) -> Option<f64> {
        share(self.right_returns, self.returns)
    }
}

/// Returns the policy that acts for the group of `policy`: the end of its chain of merges, or
/// itself. `merged_into` may have fewer items than there are policies.
pub fn acting_policy(merged_into: &[Option<usize>], policy: usize) -> usize {
    let next = |&merged: &usize| merged_into.get(merged).copied().flatten();
    // the limit ends cycles, which damaged files may have; no other chain is longer
    let chain = std::iter::successors(Some(policy), next).take(1 + merged_into.len());
    chain.last().unwrap_or(policy)
}

/// Counts one rollout of one group.
pub(crate) fn count_served(served: &mut Served, group: &str, policy: usize) {
    let of_group = served.entry(group.to_owned()).or_default();
    *of_group.entry(policy).or_default() += 1;
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const B: &str = "button-press";
    const D: &str = "drawer-close";

    fn stats(rollouts: &[(&str, bool, usize)]) -> RunStats {
        let mut stats = RunStats::default();
        for &(group, returns, policy) in rollouts {
            stats.record(group, returns, policy);
        }
        stats
    }

    /// Returns accuracy and return accuracy.
    fn accuracies(stats: &RunStats) -> [Option<f64>; 2] {
        [stats.accuracy(), stats.return_accuracy()]
    }

    #[test]
    fn a_policy_for_each_group_is_right() {
        let stats = stats(&[(B, false, 0), (B, false, 0), (D, false, 1), (B, true, 0)]);
        assert_eq!(accuracies(&stats), [Some(1.0), Some(1.0)]);
        assert_eq!(stats.opened_for, [Some(B.to_owned()), Some(D.to_owned())]);
    }

    #[test]
    fn rollouts_of_two_groups_are_counted_and_neither_right_nor_wrong() {
        let mut stats = stats(&[(B, false, 0)]);
        stats.record_task_switch(1);
        assert_eq!((stats.rollouts, stats.spanning_switch), (2, 1));
        assert_eq!(accuracies(&stats), [Some(1.0), None]);
        // the policy belongs to the group of its first rollout of one group
        stats.record(D, false, 1);
        assert_eq!(stats.accuracy(), Some(1.0));
        assert_eq!(stats.opened_for[1].as_deref(), Some(D));
        assert_eq!(RunStats::default().accuracy(), None);
    }

    /// A merge changes the number of merged policies, but not the groups that policies were created
    /// for.
    #[test]
    fn merged_policies_are_counted() {
        let mut stats = stats(&[(B, false, 0), (D, false, 1)]);
        stats.decisions = 2;
        stats.record_merges(&[None, Some(0)]);
        assert!(stats.adds_up() && stats.merged() == 1);
        stats.record_merges(&[None, None]);
        assert_eq!(stats.merged(), 0, "asked again");
        stats.record_merges(&[Some(1); 3]);
        assert!(!stats.adds_up());
    }

    /// Policies 0 and 1 belong to one group, and either may act for both.
    #[test]
    fn an_heir_is_right_where_its_policy_was() {
        for (merged_into, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut stats = stats(&[(B, false, 0), (B, false, 1)]);
            assert_eq!(stats.right, 1);
            stats.record_merges(&merged_into);
            stats.record(B, true, kept);
            assert_eq!(accuracies(&stats), [Some(2.0 / 3.0), Some(1.0)]);
        }
    }

    /// A policy that acts for two groups belongs to the group that came first.
    #[test]
    fn an_heir_of_two_groups_is_right_in_one() {
        for (merged_into, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut stats = stats(&[(B, false, 0), (D, false, 1)]);
            stats.record_merges(&merged_into);
            stats.record(D, true, kept);
            stats.record(B, true, kept);
            assert_eq!((stats.returns, stats.right_returns), (2, 1));
            assert_eq!(stats.right, 3);
        }
    }

    #[test]
    fn a_groups_own_policy_served_it_most() {
        let own = |stats: &RunStats| {
            let own = stats.own_policies();
            [B, D].map(|group| own.get(group).copied())
        };
        let mut stats = stats(&[(B, false, 1), (B, false, 0), (D, false, 0)]);
        assert_eq!(own(&stats), [Some(0), Some(0)], "of equals the first");
        stats.record(B, true, 1);
        stats.record_task_switch(2);
        assert_eq!(own(&stats), [Some(1), Some(0)]);
        stats.record_merges(&[Some(2), None, None]);
        assert_eq!(own(&stats), [Some(1), Some(2)]);
        assert_eq!(own(&RunStats::default()), [None, None]);
    }

    #[test]
    fn mixing_groups_and_splitting_a_group_are_both_wrong() {
        let mixed = stats(&[(B, false, 0), (D, false, 0), (D, false, 0), (B, true, 0)]);
        assert_eq!(accuracies(&mixed), [Some(0.5), Some(1.0)]);
        let split = stats(&[(B, false, 0), (D, false, 1), (B, true, 2), (B, true, 0)]);
        assert_eq!(accuracies(&split), [Some(0.75), Some(0.5)]);
    }

    #[test]
    fn heirs_are_followed_to_one_that_acts() {
        let merged_into = [Some(2), None, Some(1)];
        assert_eq!([0, 1, 2, 3].map(|policy| acting_policy(&merged_into, policy)), [1, 1, 1, 3]);
        assert_eq!(acting_policy(&[], 4), 4);
        assert!(acting_policy(&[Some(1), Some(0)], 0) < 2, "a circle ends");
    }
}

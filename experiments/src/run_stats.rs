//! Statistics of assignments: the group of each policy, and the rollouts that were assigned to the
//! policy of their group.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::evaluation::OwnPolicyByGroup;
use crate::schema::RolloutRow;

/// Number of rollouts by task group and by the policy that they were assigned to, without rollouts
/// that span a task switch.
pub type GroupPolicyRolloutCounts = BTreeMap<String, BTreeMap<usize, usize>>;

/// Statistics of a run so far: rollouts, decisions, failures, seconds, and assignments judged by
/// the true groups, which the learner does not see.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunStats {
    /// Group that each policy was created for: the group of its first rollout without a task
    /// switch; `None` before such a rollout.
    #[serde(rename = "opened_for")]
    pub created_for_group: Vec<Option<String>>,
    /// For each policy, the one that it was merged into, as of the last iteration
    /// ([`learner::IterationReport::merged_into`]). `correct_assignments` and own policies count a
    /// merged policy as the one that acts for it.
    #[serde(default, rename = "heirs")]
    pub merged_into: Vec<Option<usize>>,
    /// Number of rollouts by task group and by the policy that served it, without those that span a
    /// task switch. Checkpoints leave them out, since the rows of `metrics.csv` in the checkpoint
    /// hold them.
    #[serde(skip)]
    pub count_rollouts_by_group_and_policy: GroupPolicyRolloutCounts,
    /// Number of rollouts trained on, including those that span a task switch.
    pub rollouts: usize,
    /// Number of decisions taken in training.
    pub decisions: usize,
    /// Number of rollouts that span a task switch. They have no right policy, so accuracies leave
    /// them out.
    #[serde(rename = "straddled")]
    pub switch_rollouts: usize,
    /// Number of rollouts without a task switch that were assigned to the policy of their group. It
    /// is the first policy created for the group, or the one that policy was merged into, unless it
    /// belongs to another group.
    #[serde(rename = "right")]
    pub correct_assignments: usize,
    /// Number of rollouts of groups that were visited before, without a task switch.
    #[serde(rename = "returns")]
    pub revisits: usize,
    /// Number of rollouts of groups that were visited before, without a task switch, assigned to
    /// the policy of their group.
    #[serde(rename = "right_returns")]
    pub correct_revisits: usize,
    /// Number of failures of single environments in training, see
    /// [`crate::SwitchableVecEnv::environment_failures`].
    #[serde(rename = "failures")]
    pub environment_failures: usize,
    /// Wall-clock seconds of training, without evaluations. Checkpoints leave them out, so that
    /// equal runs give equal checkpoints.
    #[serde(skip)]
    pub seconds: f64,
}

impl RunStats {
    /// Computes the assignment statistics of a run from the rows of its rollouts; decisions,
    /// failures and seconds stay 0.
    pub fn from_rollouts(rollouts: &[RolloutRow]) -> Self {
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
                stats.record_rollout(&row.group, left.contains(&row.group.as_str()), row.policy);
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
    pub fn merged_policy_count(&self) -> usize {
        self.merged_into.iter().flatten().count()
    }

    /// Counts a rollout of `group` assigned to `policy`; `returns` is `true` for a revisited group.
    pub(crate) fn record_rollout(&mut self, group: &str, returns: bool, policy: usize) {
        self.open(policy);
        self.created_for_group[policy].get_or_insert_with(|| group.to_owned());
        add_rollout_count(&mut self.count_rollouts_by_group_and_policy, group, policy);
        let own = surviving_policy(&self.merged_into, policy);
        let right = usize::from(self.policy_of(group) == Some(own));
        self.rollouts += 1;
        self.correct_assignments += right;
        if returns {
            self.revisits += 1;
            self.correct_revisits += right;
        }
    }

    /// Counts a rollout that spans a task switch and was assigned to `policy`.
    pub(crate) fn record_task_switch(&mut self, policy: usize) {
        self.open(policy);
        self.rollouts += 1;
        self.switch_rollouts += 1;
    }

    /// Returns for each task group the policy that most of its rollouts were assigned to; the
    /// lowest index wins ties. Merged policies count as the policy that acts for them, and groups
    /// may share one.
    pub fn own_policies(&self) -> OwnPolicyByGroup {
        let own = |(group, served): (&String, &BTreeMap<usize, usize>)| {
            let mut acted: BTreeMap<usize, usize> = BTreeMap::new();
            for (&policy, &rollouts) in served {
                *acted.entry(surviving_policy(&self.merged_into, policy)).or_default() += rollouts;
            }
            let most =
                acted.into_iter().max_by_key(|&(policy, rollouts)| (rollouts, Reverse(policy)))?;
            Some((group.clone(), most.0))
        };
        self.count_rollouts_by_group_and_policy.iter().filter_map(own).collect()
    }

    /// Returns the policy that acts for a group; `None` without one, or if it also acts for an
    /// earlier group.
    fn policy_of(&self, group: &str) -> Option<usize> {
        let is_own = |opened: &Option<String>| opened.as_deref() == Some(group);
        let first = self.created_for_group.iter().position(is_own)?;
        let own = surviving_policy(&self.merged_into, first);
        // `own` may act for an earlier policy, whose group then has the better claim to it
        let is_others = |policy: usize| {
            self.created_for_group[policy].is_some()
                && surviving_policy(&self.merged_into, policy) == own
        };
        (!(0..first).any(is_others)).then_some(own)
    }

    /// Returns `true` if the counts are consistent: no part exceeds its whole, and every rollout
    /// has decisions.
    pub(crate) fn is_consistent(&self) -> bool {
        let of_one_group = self.rollouts.checked_sub(self.switch_rollouts);
        self.decisions >= self.rollouts
            && self.merged_policy_count() <= self.created_for_group.len()
            && of_one_group
                .is_some_and(|of_one| self.correct_assignments.max(self.revisits) <= of_one)
            && self.correct_revisits <= self.correct_assignments.min(self.revisits)
    }

    fn open(&mut self, policy: usize) {
        let policies = self.created_for_group.len().max(policy + 1);
        self.created_for_group.resize(policies, None);
    }

    /// Returns the share of rollouts without a task switch that were assigned to the policy of
    /// their group, in `[0, 1]`; `None` if there is no such rollout.
    pub fn assignment_accuracy(&self) -> Option<f64> {
        share(self.correct_assignments, self.rollouts - self.switch_rollouts)
    }

    /// Returns the assignment accuracy, in `[0, 1]`, over rollouts without a task switch of groups
    /// that were visited before; `None` without any.
    pub fn revisit_accuracy(&self) -> Option<f64> {
        share(self.correct_revisits, self.revisits)
    }
}

/// Returns the index of the policy that `policy` was merged into, directly or in several steps, or
/// `policy` itself. `merged_into` may have fewer items than there are policies.
pub fn surviving_policy(merged_into: &[Option<usize>], policy: usize) -> usize {
    let next = |&merged: &usize| merged_into.get(merged).copied().flatten();
    // the limit ends cycles, which damaged files may have; no other chain is longer
    let chain = std::iter::successors(Some(policy), next).take(1 + merged_into.len());
    chain.last().unwrap_or(policy)
}

/// Adds one rollout of `group` that was assigned to `policy` to the counts `served`.
pub(crate) fn add_rollout_count(served: &mut GroupPolicyRolloutCounts, group: &str, policy: usize) {
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
            stats.record_rollout(group, returns, policy);
        }
        stats
    }

    fn accuracies(stats: &RunStats) -> [Option<f64>; 2] {
        [stats.assignment_accuracy(), stats.revisit_accuracy()]
    }

    #[test]
    fn a_policy_for_each_group_is_right() {
        let stats = stats(&[(B, false, 0), (B, false, 0), (D, false, 1), (B, true, 0)]);
        assert_eq!(accuracies(&stats), [Some(1.0), Some(1.0)]);
        assert_eq!(stats.created_for_group, [Some(B.to_owned()), Some(D.to_owned())]);
    }

    #[test]
    fn rollouts_of_two_groups_are_counted_and_neither_right_nor_wrong() {
        let mut stats = stats(&[(B, false, 0)]);
        stats.record_task_switch(1);
        assert_eq!((stats.rollouts, stats.switch_rollouts), (2, 1));
        assert_eq!(accuracies(&stats), [Some(1.0), None]);
        // the policy belongs to the group of its first rollout of one group
        stats.record_rollout(D, false, 1);
        assert_eq!(stats.assignment_accuracy(), Some(1.0));
        assert_eq!(stats.created_for_group[1].as_deref(), Some(D));
        assert_eq!(RunStats::default().assignment_accuracy(), None);
    }

    /// A merge changes the number of merged policies, but not the groups that policies were created
    /// for.
    #[test]
    fn merged_policies_are_counted() {
        let mut stats = stats(&[(B, false, 0), (D, false, 1)]);
        stats.decisions = 2;
        stats.record_merges(&[None, Some(0)]);
        assert!(stats.is_consistent() && stats.merged_policy_count() == 1);
        stats.record_merges(&[None, None]);
        assert_eq!(stats.merged_policy_count(), 0, "asked again");
        stats.record_merges(&[Some(1); 3]);
        assert!(!stats.is_consistent());
    }

    /// Policies 0 and 1 belong to one group, and either may act for both.
    #[test]
    fn an_heir_is_right_where_its_policy_was() {
        for (merged_into, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut stats = stats(&[(B, false, 0), (B, false, 1)]);
            assert_eq!(stats.correct_assignments, 1);
            stats.record_merges(&merged_into);
            stats.record_rollout(B, true, kept);
            assert_eq!(accuracies(&stats), [Some(2.0 / 3.0), Some(1.0)]);
        }
    }

    /// A policy that acts for two groups belongs to the group that came first.
    #[test]
    fn an_heir_of_two_groups_is_right_in_one() {
        for (merged_into, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut stats = stats(&[(B, false, 0), (D, false, 1)]);
            stats.record_merges(&merged_into);
            stats.record_rollout(D, true, kept);
            stats.record_rollout(B, true, kept);
            assert_eq!((stats.revisits, stats.correct_revisits), (2, 1));
            assert_eq!(stats.correct_assignments, 3);
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
        stats.record_rollout(B, true, 1);
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
        assert_eq!([0, 1, 2, 3].map(|policy| surviving_policy(&merged_into, policy)), [1, 1, 1, 3]);
        assert_eq!(surviving_policy(&[], 4), 4);
        assert!(surviving_policy(&[Some(1), Some(0)], 0) < 2, "a circle ends");
    }
}

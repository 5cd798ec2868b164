//! Which policy was opened for which group, and how often the right one was assigned.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::evaluation::OwnPolicies;
use crate::schema::RolloutRow;

/// For each group the policies that served it, and in how many rollouts of this group alone.
pub type Served = BTreeMap<String, BTreeMap<usize, usize>>;

/// What the stream knows and the learner does not: the books of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ledger {
    /// The group that each policy was opened for: that of its first rollout of one group alone.
    pub opened_for: Vec<Option<String>>,
    /// For each policy the one that acts for its group since the two were merged, after the last
    /// turn ([`learner::Iteration::merged_into`]). The counts below follow them: a policy counts as its heir.
    #[serde(default)]
    pub heirs: Vec<Option<usize>>,
    /// Rollouts of one group, by group and by the policy that served it. A checkpoint leaves them
    /// out: the rows of its `metrics.csv` hold them.
    #[serde(skip)]
    pub served: Served,
    /// Rollouts learnt from.
    pub rollouts: usize,
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Rollouts within which the stream changed the group: nobody can say which policy is right.
    pub straddled: usize,
    /// The other rollouts assigned to the policy of their group: the first that was opened for it,
    /// or its heir where that is no other group's policy.
    pub right: usize,
    /// Rollouts of groups that came back.
    pub returns: usize,
    /// Those of them that were assigned to the policy of their group.
    pub right_returns: usize,
    /// Failures of single environments, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Seconds of learning on the wall clock, without evaluations. A checkpoint leaves them out:
    /// equal runs give equal checkpoints.
    #[serde(skip)]
    pub seconds: f64,
}

impl Ledger {
    /// The books of a run after these rollouts.
    pub fn of(rollouts: &[RolloutRow]) -> Self {
        let mut ledger = Self::default();
        let mut left: Vec<&str> = Vec::new();
        for (index, row) in rollouts.iter().enumerate() {
            if let Some(before) = index.checked_sub(1).map(|before| &rollouts[before])
                && (before.straddles || before.group != row.group)
            {
                left.push(&before.group);
                // a visit that was over within a turn
                if before.last_group != row.group {
                    left.push(&before.last_group);
                }
            }
            if row.straddles {
                ledger.record_straddling(row.policy);
            } else {
                ledger.record(&row.group, left.contains(&row.group.as_str()), row.policy);
            }
            ledger.record_heirs(&row.heirs);
        }
        ledger
    }

    /// Books who acts for whom after a turn.
    pub(crate) fn record_heirs(&mut self, heirs: &[Option<usize>]) {
        self.heirs = heirs.to_vec();
    }

    /// The number of policies that have an heir.
    pub fn merged(&self) -> usize {
        self.heirs.iter().flatten().count()
    }

    /// Books one rollout of one group; `returns` says that its group was visited before.
    pub(crate) fn record(&mut self, group: &str, returns: bool, policy: usize) {
        self.open(policy);
        self.opened_for[policy].get_or_insert_with(|| group.to_owned());
        count_served(&mut self.served, group, policy);
        let own = acting(&self.heirs, policy);
        let right = usize::from(self.policy_of(group) == Some(own));
        self.rollouts += 1;
        self.right += right;
        if returns {
            self.returns += 1;
            self.right_returns += right;
        }
    }

    /// Books one rollout that began in one group and ended in another.
    pub(crate) fn record_straddling(&mut self, policy: usize) {
        self.open(policy);
        self.rollouts += 1;
        self.straddled += 1;
    }

    /// The policy that served each group in most of its rollouts, of equals the first; a policy
    /// counts as the one that acts for its group. Two groups may share one.
    pub fn own_policies(&self) -> OwnPolicies {
        let own = |(group, served): (&String, &BTreeMap<usize, usize>)| {
            let mut acted: BTreeMap<usize, usize> = BTreeMap::new();
            for (&policy, &rollouts) in served {
                *acted.entry(acting(&self.heirs, policy)).or_default() += rollouts;
            }
            let most =
                acted.into_iter().max_by_key(|&(policy, rollouts)| (rollouts, Reverse(policy)))?;
            Some((group.clone(), most.0))
        };
        self.served.iter().filter_map(own).collect()
    }

    /// The policy that acts for a group; none where it was another group's before.
    fn policy_of(&self, group: &str) -> Option<usize> {
        let is_own = |opened: &Option<String>| opened.as_deref() == Some(group);
        let first = self.opened_for.iter().position(is_own)?;
        let own = acting(&self.heirs, first);
        let is_others =
            |policy: usize| self.opened_for[policy].is_some() && acting(&self.heirs, policy) == own;
        (!(0..first).any(is_others)).then_some(own)
    }

    /// Whether no part is more than its whole, and no rollout is without decisions.
    pub(crate) fn adds_up(&self) -> bool {
        let of_one_group = self.rollouts.checked_sub(self.straddled);
        self.decisions >= self.rollouts
            && self.merged() <= self.opened_for.len()
            && of_one_group.is_some_and(|of_one| self.right.max(self.returns) <= of_one)
            && self.right_returns <= self.right.min(self.returns)
    }

    fn open(&mut self, policy: usize) {
        let policies = self.opened_for.len().max(policy + 1);
        self.opened_for.resize(policies, None);
    }

    /// Share of rollouts of one group assigned to its policy, in `[0, 1]`; none where there was no
    /// such rollout.
    pub fn accuracy(&self) -> Option<f64> {
        share(self.right, self.rollouts - self.straddled)
    }

    /// That share among the rollouts of groups that came back; none where none did.
    pub fn return_accuracy(&self) -> Option<f64> {
        share(self.right_returns, self.returns)
    }
}

/// The policy that acts for the group of `policy`: its heir, or the heir's heir, or itself. `heirs`
/// has one item for each policy, or fewer.
pub fn acting(heirs: &[Option<usize>], policy: usize) -> usize {
    let heir = |&policy: &usize| heirs.get(policy).copied().flatten();
    let line = std::iter::successors(Some(policy), heir);
    // no line is longer, unless it is a circle
    line.take(1 + heirs.len()).last().unwrap_or(policy)
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

    fn ledger(rollouts: &[(&str, bool, usize)]) -> Ledger {
        let mut ledger = Ledger::default();
        for &(group, returns, policy) in rollouts {
            ledger.record(group, returns, policy);
        }
        ledger
    }

    /// Both shares.
    fn accuracies(ledger: &Ledger) -> [Option<f64>; 2] {
        [ledger.accuracy(), ledger.return_accuracy()]
    }

    #[test]
    fn a_policy_for_each_group_is_right() {
        let ledger = ledger(&[(B, false, 0), (B, false, 0), (D, false, 1), (B, true, 0)]);
        assert_eq!(accuracies(&ledger), [Some(1.0), Some(1.0)]);
        assert_eq!(ledger.opened_for, [Some(B.to_owned()), Some(D.to_owned())]);
    }

    #[test]
    fn rollouts_of_two_groups_are_counted_and_neither_right_nor_wrong() {
        let mut ledger = ledger(&[(B, false, 0)]);
        ledger.record_straddling(1);
        assert_eq!((ledger.rollouts, ledger.straddled), (2, 1));
        assert_eq!(accuracies(&ledger), [Some(1.0), None]);
        // the policy belongs to the group of its first rollout of one group
        ledger.record(D, false, 1);
        assert_eq!(ledger.accuracy(), Some(1.0));
        assert_eq!(ledger.opened_for[1].as_deref(), Some(D));
        assert_eq!(Ledger::default().accuracy(), None);
    }

    /// Policies that were merged are counted, and what they were opened for stays.
    #[test]
    fn merged_policies_are_counted() {
        let mut ledger = ledger(&[(B, false, 0), (D, false, 1)]);
        ledger.decisions = 2;
        ledger.record_heirs(&[None, Some(0)]);
        assert!(ledger.adds_up() && ledger.merged() == 1);
        ledger.record_heirs(&[None, None]);
        assert_eq!(ledger.merged(), 0, "asked again");
        ledger.record_heirs(&[Some(1); 3]);
        assert!(!ledger.adds_up());
    }

    /// Policies 0 and 1 are of one group, and either may go on for both.
    #[test]
    fn an_heir_is_right_where_its_policy_was() {
        for (heirs, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut ledger = ledger(&[(B, false, 0), (B, false, 1)]);
            assert_eq!(ledger.right, 1);
            ledger.record_heirs(&heirs);
            ledger.record(B, true, kept);
            assert_eq!(accuracies(&ledger), [Some(2.0 / 3.0), Some(1.0)]);
        }
    }

    /// One that goes on for two groups belongs to the one that came first.
    #[test]
    fn an_heir_of_two_groups_is_right_in_one() {
        for (heirs, kept) in [([None, Some(0)], 0), ([Some(1), None], 1)] {
            let mut ledger = ledger(&[(B, false, 0), (D, false, 1)]);
            ledger.record_heirs(&heirs);
            ledger.record(D, true, kept);
            ledger.record(B, true, kept);
            assert_eq!((ledger.returns, ledger.right_returns), (2, 1));
            assert_eq!(ledger.right, 3);
        }
    }

    #[test]
    fn a_groups_own_policy_served_it_most() {
        let own = |ledger: &Ledger| {
            let own = ledger.own_policies();
            [B, D].map(|group| own.get(group).copied())
        };
        let mut ledger = ledger(&[(B, false, 1), (B, false, 0), (D, false, 0)]);
        assert_eq!(own(&ledger), [Some(0), Some(0)], "of equals the first");
        ledger.record(B, true, 1);
        ledger.record_straddling(2);
        assert_eq!(own(&ledger), [Some(1), Some(0)]);
        ledger.record_heirs(&[Some(2), None, None]);
        assert_eq!(own(&ledger), [Some(1), Some(2)]);
        assert_eq!(own(&Ledger::default()), [None, None]);
    }

    #[test]
    fn mixing_groups_and_splitting_a_group_are_both_wrong() {
        let mixed = ledger(&[(B, false, 0), (D, false, 0), (D, false, 0), (B, true, 0)]);
        assert_eq!(accuracies(&mixed), [Some(0.5), Some(1.0)]);
        let split = ledger(&[(B, false, 0), (D, false, 1), (B, true, 2), (B, true, 0)]);
        assert_eq!(accuracies(&split), [Some(0.75), Some(0.5)]);
    }

    #[test]
    fn heirs_are_followed_to_one_that_acts() {
        let heirs = [Some(2), None, Some(1)];
        assert_eq!([0, 1, 2, 3].map(|policy| acting(&heirs, policy)), [1, 1, 1, 3]);
        assert_eq!(acting(&[], 4), 4);
        assert!(acting(&[Some(1), Some(0)], 0) < 2, "a circle ends");
    }
}

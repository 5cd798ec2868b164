//! Which policy was opened for which group, and how often the right one was assigned.

use serde::{Deserialize, Serialize};

/// What the stream knows and the learner does not: the books of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ledger {
    /// The group that each policy was opened for.
    pub opened_for: Vec<String>,
    /// Rollouts learnt from.
    pub rollouts: usize,
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Rollouts within which the stream changed the group: nobody can say which policy is right.
    pub straddled: usize,
    /// The other rollouts assigned to the first policy that was opened for their group.
    pub right: usize,
    /// Rollouts of groups that came back.
    pub returns: usize,
    /// Those of them that were assigned to the first policy of their group.
    pub right_returns: usize,
    /// Failures of single environments, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Seconds of learning on the wall clock, without evaluations. A checkpoint leaves them out:
    /// equal runs give equal checkpoints.
    #[serde(skip)]
    pub seconds: f64,
}

impl Ledger {
    /// Books one rollout of one group; `returns` says that its group was visited before.
    pub(crate) fn record(&mut self, group: &str, returns: bool, policy: usize) {
        self.open(group, policy);
        let first = self.opened_for.iter().position(|opened| opened == group);
        let right = usize::from(first == Some(policy));
        self.rollouts += 1;
        self.right += right;
        if returns {
            self.returns += 1;
            self.right_returns += right;
        }
    }

    /// Books one rollout that began in this group and ended in another.
    pub(crate) fn record_straddling(&mut self, group: &str, policy: usize) {
        self.open(group, policy);
        self.rollouts += 1;
        self.straddled += 1;
    }

    fn open(&mut self, group: &str, policy: usize) {
        if policy == self.opened_for.len() {
            self.opened_for.push(group.to_owned());
        }
    }

    /// Share of rollouts of one group assigned to the first policy that was opened for it, in
    /// `[0, 1]`.
    pub fn accuracy(&self) -> f64 {
        self.right as f64 / (self.rollouts - self.straddled).max(1) as f64
    }

    /// That share among the rollouts of groups that came back; 1 where none did.
    pub fn return_accuracy(&self) -> f64 {
        match self.returns {
            0 => 1.0,
            returns => self.right_returns as f64 / returns as f64,
        }
    }
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

    #[test]
    fn a_policy_for_each_group_is_right() {
        let ledger = ledger(&[(B, false, 0), (B, false, 0), (D, false, 1), (B, true, 0)]);
        assert_eq!((ledger.accuracy(), ledger.return_accuracy()), (1.0, 1.0));
        assert_eq!(ledger.opened_for, [B, D]);
    }

    #[test]
    fn rollouts_of_two_groups_are_counted_and_neither_right_nor_wrong() {
        let mut ledger = ledger(&[(B, false, 0)]);
        ledger.record_straddling(D, 1);
        assert_eq!(
            (ledger.rollouts, ledger.straddled, ledger.accuracy()),
            (2, 1, 1.0)
        );
        assert_eq!(ledger.opened_for, [B, D]);
    }

    #[test]
    fn mixing_groups_and_splitting_a_group_are_both_wrong() {
        let mixed = ledger(&[(B, false, 0), (D, false, 0), (D, false, 0), (B, true, 0)]);
        assert_eq!((mixed.accuracy(), mixed.return_accuracy()), (0.5, 1.0));
        let split = ledger(&[(B, false, 0), (D, false, 1), (B, true, 2), (B, true, 0)]);
        assert_eq!((split.accuracy(), split.return_accuracy()), (0.75, 0.5));
    }
}

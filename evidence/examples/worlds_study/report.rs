//! The table.

use std::cmp::Reverse;
use std::fmt;

use worlds::Kind;

use crate::trial::{Outcome, Turn};

/// A turn, whether policy and group belong to each other, and whether the group had just changed.
type Judged = (Turn, bool, bool);

/// One line of the table.
pub struct Report {
    kind: Kind,
    worlds: usize,
    exact: f64,
    superfluous: usize,
    missing: usize,
    /// Shares; none where nothing was asked.
    right: Option<f64>,
    noticed: Option<f64>,
    split: Option<f64>,
    mixed: usize,
    rollouts: f64,
}

impl Report {
    pub const HEADER: &str = "| worlds | number | exact policies | most superfluous | most missing \
| right after first visits | switches noticed at once | mixed rollouts | split exactly \
| rollouts a turn |\n|---|---|---|---|---|---|---|---|---|---|";

    pub fn of(kind: Kind, outcomes: &[Outcome]) -> Self {
        let difference = |o: &Outcome| {
            (
                o.policies.saturating_sub(o.distinct),
                o.distinct.saturating_sub(o.policies),
            )
        };
        let differences = outcomes.iter().map(difference);
        let exact = outcomes.iter().filter(|outcome| is_exact(outcome)).count();
        let judged: Vec<Judged> = outcomes.iter().flat_map(judge).collect();
        let share = |of: fn(&Judged) -> Option<bool>| {
            let asked: Vec<bool> = judged.iter().filter_map(of).collect();
            let yes = asked.iter().filter(|&&yes| yes).count() as f64;
            (!asked.is_empty()).then(|| yes / asked.len() as f64)
        };
        let turns = judged.len().max(1) as f64;
        Self {
            kind,
            worlds: outcomes.len(),
            exact: exact as f64 / outcomes.len().max(1) as f64,
            superfluous: differences.clone().map(|d| d.0).max().unwrap_or(0),
            missing: differences.map(|d| d.1).max().unwrap_or(0),
            right: share(|(turn, right, _)| turn.is_known.then_some(*right)),
            noticed: share(|(turn, right, switch)| (turn.is_known && *switch).then_some(*right)),
            mixed: judged
                .iter()
                .filter(|(turn, _, _)| turn.is_cut.is_some())
                .count(),
            split: share(|(turn, _, _)| turn.is_cut),
            rollouts: judged
                .iter()
                .map(|(turn, _, _)| turn.rollouts as f64)
                .sum::<f64>()
                / turns,
        }
    }
}

/// Turns that each policy served each group, `[policies][groups]`.
struct Served(Vec<Vec<usize>>);

impl Served {
    fn of(outcome: &Outcome) -> Self {
        let groups = outcome.turns.iter().map(|turn| turn.group + 1).max();
        let mut served = vec![vec![0; groups.unwrap_or(0)]; outcome.policies];
        for turn in &outcome.turns {
            served[turn.policy][turn.group] += 1;
        }
        Self(served)
    }

    /// Whether the policy served this group most, and the group had no other policy that served it
    /// more. The first of equals counts.
    fn is_pair(&self, policy: usize, group: usize) -> bool {
        let by_group = self.0[policy].iter().copied();
        let by_policy = self.0.iter().map(|served| served[group]);
        most(by_group) == Some(group) && most(by_policy) == Some(policy)
    }

    /// Whether policies and groups belong to each other one to one.
    fn is_bijection(&self, distinct: usize) -> bool {
        let mut policies = self.0.iter().enumerate();
        let is_paired = |(policy, served): (usize, &Vec<usize>)| {
            most(served.iter().copied()).is_some_and(|group| self.is_pair(policy, group))
        };
        self.0.len() == distinct && policies.all(is_paired)
    }
}

/// The index of the largest number above zero, the first of equals.
fn most(numbers: impl Iterator<Item = usize>) -> Option<usize> {
    let numbers = numbers.enumerate().filter(|&(_, number)| number > 0);
    let index = numbers.min_by_key(|&(_, number)| Reverse(number));
    index.map(|(index, _)| index)
}

/// Whether each group has a policy of its own, and no policy is left over.
fn is_exact(outcome: &Outcome) -> bool {
    Served::of(outcome).is_bijection(outcome.distinct)
}

fn judge(outcome: &Outcome) -> Vec<Judged> {
    let served = Served::of(outcome);
    let turns = outcome.turns.iter().enumerate();
    let judged = turns.map(|(index, turn)| {
        let before = index.checked_sub(1).map(|i| outcome.turns[i].group);
        let is_switch = before.is_some_and(|group| group != turn.group);
        (*turn, served.is_pair(turn.policy, turn.group), is_switch)
    });
    judged.collect()
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: Option<f64>| {
            share.map_or("-".to_owned(), |share| format!("{:.1} %", 100.0 * share))
        };
        write!(
            f,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.2} |",
            self.kind.name(),
            self.worlds,
            percent(Some(self.exact)),
            self.superfluous,
            self.missing,
            percent(self.right),
            percent(self.noticed),
            self.mixed,
            percent(self.split),
            self.rollouts,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns given as policy and group; all groups are known.
    fn outcome(policies: usize, distinct: usize, turns: &[(usize, usize)]) -> Outcome {
        let turn = |&(policy, group): &(usize, usize)| Turn {
            group,
            policy,
            rollouts: 1,
            is_known: true,
            is_cut: None,
        };
        Outcome {
            distinct,
            policies,
            turns: turns.iter().map(turn).collect(),
        }
    }

    fn right(outcome: &Outcome) -> Vec<bool> {
        judge(outcome).iter().map(|judged| judged.1).collect()
    }

    #[test]
    fn a_switch_that_nobody_noticed_is_not_right() {
        let late = outcome(2, 2, &[(0, 0), (0, 0), (0, 1), (1, 1), (1, 1)]);
        assert_eq!(right(&late), [true, true, false, true, true]);
        assert_eq!(judge(&late).iter().filter(|judged| judged.2).count(), 1);
        assert!(is_exact(&late));
        let report = Report::of(Kind::Shape, &[late]);
        assert_eq!((report.right, report.noticed), (Some(0.8), Some(0.0)));
    }

    #[test]
    fn a_policy_a_turn_is_neither_right_nor_exact() {
        let every = outcome(4, 2, &[(0, 0), (1, 0), (2, 1), (3, 1)]);
        assert_eq!(right(&every), [true, false, true, false]);
        assert!(!is_exact(&every));
    }

    #[test]
    fn as_many_policies_as_groups_are_not_exact_unless_they_pair() {
        // one policy serves two groups, and one group has two policies
        let crossed = outcome(3, 3, &[(0, 0), (0, 0), (0, 1), (1, 2), (1, 2), (2, 2)]);
        assert!(!is_exact(&crossed));
        let idle = outcome(2, 2, &[(0, 0), (0, 1)]);
        assert!(!is_exact(&idle), "a policy that never served");
        assert!(is_exact(&outcome(2, 2, &[(1, 0), (0, 1)])));
    }
}

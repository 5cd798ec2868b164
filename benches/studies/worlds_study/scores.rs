//! Scores of the turns of a world.

use std::cmp::Reverse;

use crate::Job;
use crate::record::StudyRecord;
use crate::trial::{IterationOutcome, StreamOutcome};

/// Turn, with `true` if policy and group belong to each other, and `true` if the group had just
/// changed.
type Judged = (IterationOutcome, bool, bool);

/// Numbers of turns in which each policy served each group, `[policies][groups]`.
struct Served(Vec<Vec<usize>>);

impl Served {
    fn of(outcome: &StreamOutcome) -> Self {
        let groups = outcome.turns.iter().map(|turn| turn.group + 1).max();
        let mut served = vec![vec![0; groups.unwrap_or(0)]; outcome.policies];
        for turn in &outcome.turns {
            served[outcome.policy_after_merges(turn.policy)][turn.group] += 1;
        }
        Self(served)
    }

    /// Returns `true` if the policy served this group most, and no other policy served the group
    /// more. On a tie the first one counts.
    fn is_pair(&self, policy: usize, group: usize) -> bool {
        let by_group = self.0[policy].iter().copied();
        let by_policy = self.0.iter().map(|served| served[group]);
        most(by_group) == Some(group) && most(by_policy) == Some(policy)
    }
}

/// Returns the index of the largest number above zero, on a tie the first; `None` if there is none.
fn most(numbers: impl Iterator<Item = usize>) -> Option<usize> {
    let numbers = numbers.enumerate().filter(|&(_, number)| number > 0);
    let index = numbers.min_by_key(|&(_, number)| Reverse(number));
    index.map(|(index, _)| index)
}

/// Returns `true` if policies and groups belong to each other one to one, and no policy is left
/// over. Merged policies are left out.
fn is_exact(outcome: &StreamOutcome) -> bool {
    let served = Served::of(outcome);
    let policies =
        (0..outcome.policies).filter(|&policy| outcome.policy_after_merges(policy) == policy);
    let mut groups = policies.map(|policy| (policy, most(served.0[policy].iter().copied())));
    outcome.num_remaining_policies() == outcome.distinct
        && groups.all(|(policy, group)| group.is_some_and(|group| served.is_pair(policy, group)))
}

fn judge(outcome: &StreamOutcome) -> Vec<Judged> {
    let served = Served::of(outcome);
    let turns = outcome.turns.iter().enumerate();
    let judged = turns.map(|(index, turn)| {
        let before = index.checked_sub(1).map(|i| outcome.turns[i].group);
        let is_switch = before.is_some_and(|group| group != turn.group);
        let policy = outcome.policy_after_merges(turn.policy);
        (*turn, served.is_pair(policy, turn.group), is_switch)
    });
    judged.collect()
}

/// Counts right and wrong assignments in the outcome of one world.
pub fn count_assignments(job: &Job, outcome: &StreamOutcome) -> StudyRecord {
    let judged = judge(outcome);
    let served = Served::of(outcome);
    let count = |holds: &dyn Fn(&Judged) -> bool| judged.iter().filter(|j| holds(j)).count();
    let learnt = outcome.turns.iter().flat_map(|turn| {
        let (served, policy) = (&served, outcome.policy_after_merges(turn.policy));
        turn.learnt.iter().flatten().map(move |&group| served.is_pair(policy, group))
    });
    let learnt: Vec<bool> = learnt.collect();
    StudyRecord {
        groups: outcome.distinct,
        policies: outcome.num_remaining_policies(),
        exact: usize::from(is_exact(outcome)),
        turns: judged.len(),
        rounds: outcome.turns.iter().map(|turn| turn.rounds).sum(),
        known: count(&|(turn, _, _)| turn.is_known),
        right: count(&|(turn, right, _)| turn.is_known && *right),
        switches: count(&|(turn, _, new)| turn.is_known && *new),
        noticed: count(&|(turn, right, new)| turn.is_known && *new && *right),
        learnt: learnt.len(),
        foreign: learnt.iter().filter(|&&is_own| !is_own).count(),
        merged: outcome.num_merged_policies(),
        slowest_us: outcome.slowest.as_micros(),
        ..StudyRecord::new(job)
    }
}

#[cfg(test)]
mod tests {
    use worlds::WorldKind;

    use super::*;
    use crate::cases::{AssignmentRule, StudyCase, VisitPlan};

    /// Returns an outcome with these turns, given as policy and group; all groups are known.
    fn outcome(policies: usize, distinct: usize, turns: &[(usize, usize)]) -> StreamOutcome {
        let turn = |&(policy, group): &(usize, usize)| IterationOutcome {
            group,
            policy,
            rounds: 4,
            is_known: true,
            last: 0,
            learnt: [Some(group), Some(group), None, None],
        };
        StreamOutcome {
            distinct,
            policies,
            turns: turns.iter().map(turn).collect(),
            ..StreamOutcome::default()
        }
    }

    fn right(outcome: &StreamOutcome) -> Vec<bool> {
        judge(outcome).iter().map(|judged| judged.1).collect()
    }

    #[test]
    fn a_switch_that_nobody_noticed_is_not_right() {
        let late = outcome(2, 2, &[(0, 0), (0, 0), (0, 1), (1, 1), (1, 1)]);
        assert_eq!(right(&late), [true, true, false, true, true]);
        assert_eq!(judge(&late).iter().filter(|judged| judged.2).count(), 1);
        let case = StudyCase::Kind(WorldKind::Shape);
        let job = Job { case, rule: AssignmentRule::Evidence, plan: VisitPlan::default(), seed: 7 };
        let record = count_assignments(&job, &late);
        assert_eq!([record.exact, record.known, record.right], [1, 5, 4]);
        assert_eq!([record.switches, record.noticed], [1, 0]);
        assert_eq!([record.learnt, record.foreign], [10, 2]);
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

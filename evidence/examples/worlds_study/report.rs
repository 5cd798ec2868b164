//! The table.

use std::fmt;

use worlds::Kind;

use crate::trial::{Outcome, Turn};

/// A turn, whether its policy is the one that serves its group most, and whether the group had
/// just changed.
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
    exactly_split: Option<f64>,
    mixed: usize,
    rollouts: f64,
}

impl Report {
    pub const HEADER: &str = "| worlds | number | exact policies | most superfluous | most missing \
| right after first visits | switches noticed at once | mixed rollouts | split within one episode \
| exactly | rollouts a turn |\n|---|---|---|---|---|---|---|---|---|---|---|";

    pub fn of(kind: Kind, outcomes: &[Outcome]) -> Self {
        let difference = |o: &Outcome| {
            (
                o.policies.saturating_sub(o.distinct),
                o.distinct.saturating_sub(o.policies),
            )
        };
        let differences = outcomes.iter().map(difference);
        let exact = differences.clone().filter(|&d| d == (0, 0)).count();
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
                .filter(|(turn, _, _)| turn.cut.is_some())
                .count(),
            split: share(|(turn, _, _)| turn.cut.map(|cut| cut.is_some_and(|by| by <= 1))),
            exactly_split: share(|(turn, _, _)| turn.cut.map(|cut| cut == Some(0))),
            rollouts: judged
                .iter()
                .map(|(turn, _, _)| turn.rollouts as f64)
                .sum::<f64>()
                / turns,
        }
    }
}

fn judge(outcome: &Outcome) -> Vec<Judged> {
    let served = |policy, group| {
        let turns = outcome.turns.iter();
        turns
            .filter(|t| t.policy == policy && t.group == group)
            .count()
    };
    let groups = outcome.turns.iter().map(|t| t.group).max().unwrap_or(0) + 1;
    // a policy belongs to the group that it served most, and a group to the policy that did
    let owner = |policy| (0..groups).max_by_key(|&group| served(policy, group));
    let turns = outcome.turns.iter().enumerate();
    let judged = turns.map(|(index, turn)| {
        let before = index.checked_sub(1).map(|i| outcome.turns[i].group);
        let right = [turn.group, turn.half]
            .map(Some)
            .contains(&owner(turn.policy));
        (
            *turn,
            right,
            before.is_some_and(|group| group != turn.group),
        )
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
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.2} |",
            self.kind.name(),
            self.worlds,
            percent(Some(self.exact)),
            self.superfluous,
            self.missing,
            percent(self.right),
            percent(self.noticed),
            self.mixed,
            percent(self.split),
            percent(self.exactly_split),
            self.rollouts,
        )
    }
}

//! What is remembered of one policy.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::account::{Account, check_len};
use crate::error::EvidenceError;
use crate::opinion::{Kind, mean_earned};

/// What a policy is known by: the accounts of the latest episodes on which it learnt.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Memory {
    pub(crate) accounts: VecDeque<Account>,
    /// Mean earnings of the first rollout on which it learnt.
    pub(crate) beginning: Option<f64>,
    /// Policies that were found to serve other groups.
    pub(crate) apart: Vec<usize>,
    /// The policy that serves its group, too, and acts for it.
    pub(crate) heir: Option<usize>,
}

impl Memory {
    /// Whether another policy acts for its group.
    pub(crate) fn is_gone(&self) -> bool {
        self.heir.is_some()
    }

    /// Remembers the latest of these, `most` at most.
    pub(crate) fn learn(&mut self, accounts: Vec<&Account>, most: usize) {
        let earned = mean_earned(accounts.iter().copied());
        self.beginning = self.beginning.or(earned);
        self.accounts.extend(accounts.into_iter().cloned());
        let too_many = self.accounts.len().saturating_sub(most);
        self.accounts.drain(..too_many);
    }

    /// Whether there are accounts, `most` at most, the beginning is a number, and the policies that
    /// are named are among so many.
    pub(crate) fn check(&self, most: usize, policies: usize) -> Result<(), EvidenceError> {
        let mut named = self.apart.iter().copied().chain(self.heir);
        if let Some(policy) = named.find(|&policy| policy >= policies) {
            return Err(EvidenceError::NoPolicy { policy, policies });
        }
        match self.accounts.len() {
            0 => Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 }),
            got if got > most => Err(EvidenceError::TooManyAccounts { got, most }),
            _ => self.beginning.map_or(Ok(()), |b| finite("beginning", b)),
        }
    }

    /// What the policy did of late, where it earns more than before: a policy that learns is not
    /// what it was. Else all that is remembered.
    pub(crate) fn home(&self) -> Vec<&Account> {
        let all: Vec<&Account> = self.accounts.iter().collect();
        let (before, late) = all.split_at(all.len() / 2);
        let means = mean_earned(before.iter().copied()).zip(mean_earned(late.iter().copied()));
        match means {
            Some((before, mean)) if mean - before > IMPROVES * spread(&all) => late.to_vec(),
            _ => all,
        }
    }

    /// What was learnt to earn, in standard deviations of what is earned: how surely the policy
    /// would notice that it earns it no more.
    pub(crate) fn learnt(&self) -> f64 {
        self.gained(&self.home())
    }

    /// How much more these accounts earned than the first rollout, in their standard deviations.
    pub(crate) fn gained(&self, accounts: &[&Account]) -> f64 {
        match (self.beginning, mean_earned(accounts.iter().copied())) {
            (Some(beginning), Some(earned)) => {
                let spread = spread(accounts).max(f64::MIN_POSITIVE);
                ((earned - beginning) / spread).clamp(0.0, f64::MAX)
            }
            _ => 0.0,
        }
    }

    /// The share of what was learnt to earn that `accounts` did not pay, at most 1 for those that
    /// pay what the first rollout paid. What was learnt counts as half of what is earned at least:
    /// else noise would be a large share of little.
    pub(crate) fn lost(&self, accounts: &[&Account]) -> f64 {
        let now = mean_earned(accounts.iter().copied());
        match self.worth().zip(now) {
            Some(((home, worth), now)) => (home - now) / worth,
            None => 0.0,
        }
    }

    /// The standard error of that share.
    pub(crate) fn lost_error(&self, accounts: &[&Account]) -> f64 {
        let home = self.home();
        let variance = |of: &[&Account]| spread(of).powi(2) / of.len().max(1) as f64;
        let error = (variance(accounts) + variance(&home)).sqrt();
        self.worth().map_or(0.0, |(_, worth)| error / worth)
    }

    /// What is earned at home, and how much of that counts as learnt; none where nothing was.
    fn worth(&self) -> Option<(f64, f64)> {
        let home = mean_earned(self.home().into_iter())?;
        let learnt = home - self.beginning?;
        (learnt > 0.0).then(|| (home, learnt.max(home.abs() / 2.0)))
    }
}

/// A policy improves if the later half of its earnings is better by so many standard deviations.
const IMPROVES: f64 = 0.5;

/// Standard deviation of what was earned; zero where nothing is known of it.
fn spread(accounts: &[&Account]) -> f64 {
    let Some(mean) = mean_earned(accounts.iter().copied()) else {
        return 0.0;
    };
    let squares = accounts.iter().filter_map(|a| a.earned).map(|e| (f64::from(e) - mean).powi(2));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), s| (sum + s, count + 1.0));
    f64::sqrt(sum / count)
}

/// Refuses a policy whose heir, or one of the heir's heirs, is the policy itself.
pub(crate) fn check_heirs(memories: &[Memory]) -> Result<(), EvidenceError> {
    let heir = |&policy: &usize| memories[policy].heir;
    // without a circle nobody has more heirs than there are others
    let circles =
        |policy: &usize| std::iter::successors(Some(*policy), heir).nth(memories.len()).is_some();
    match (0..memories.len()).find(circles) {
        Some(policy) => Err(EvidenceError::HeirsInCircle { policy }),
        None => Ok(()),
    }
}

/// All accounts that are remembered.
pub(crate) fn known(memories: &[Memory]) -> impl Iterator<Item = &Account> + Clone {
    memories.iter().flat_map(|memory| &memory.accounts)
}

/// Whether accounts can be compared: all numbers are finite, and each source is as long in all
/// accounts as in the first that has it.
pub(crate) fn check<'a>(
    accounts: impl Iterator<Item = &'a Account> + Clone,
) -> Result<(), EvidenceError> {
    for kind in Kind::ALL {
        let mut expected = None;
        for point in accounts.clone().filter_map(|account| kind.point(account)) {
            let expected = *expected.get_or_insert(point.len().max(1));
            check_len(kind.name(), point.len(), expected)?;
            let mut numbers = point.iter().map(|&value| finite(kind.name(), value.into()));
            numbers.try_for_each(|number| number)?;
        }
    }
    Ok(())
}

fn finite(what: &'static str, value: f64) -> Result<(), EvidenceError> {
    if value.is_finite() { Ok(()) } else { Err(EvidenceError::NotFinite { what, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paid(earned: f32) -> Account {
        Account {
            began: 0,
            picture: vec![0.0],
            vector: vec![0.0],
            motion: None,
            slope: None,
            earned: Some(earned),
        }
    }

    fn lost(beginning: f64, home: f32, now: f32) -> f64 {
        let memory = Memory {
            accounts: [paid(home)].into(),
            beginning: Some(beginning),
            ..Memory::default()
        };
        memory.lost(&[&paid(now)])
    }

    #[test]
    fn noise_is_no_loss_where_little_was_learnt() {
        assert!(lost(100.0, 101.0, 99.5) < 0.05);
        assert!(lost(-101.0, -100.0, -101.5) < 0.05);
    }

    #[test]
    fn what_was_learnt_can_be_lost() {
        assert_eq!(lost(0.0, 100.0, 60.0), 0.4);
        assert_eq!(lost(-20.0, -4.0, -12.0), 0.5);
        assert!(lost(0.0, 100.0, 110.0) < 0.0, "more than at home");
        assert_eq!(lost(100.0, 100.0, 10.0), 0.0, "nothing learnt");
    }

    /// Two episodes that earn 40 and 80, beside a home without spread that earns 100.
    #[test]
    fn a_loss_is_known_up_to_the_spread_of_what_is_earned() {
        let memory =
            Memory { accounts: [paid(100.0)].into(), beginning: Some(0.0), ..Memory::default() };
        let (low, high) = (paid(40.0), paid(80.0));
        assert_eq!(memory.lost(&[&low, &high]), 0.4);
        let error = memory.lost_error(&[&low, &high]);
        assert!((error - 0.2 / f64::sqrt(2.0)).abs() < 1e-12, "{error}");
    }
}

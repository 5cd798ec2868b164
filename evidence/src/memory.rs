//! Memory of the episodes that one policy trained on.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::account::{Account, check_len};
use crate::error::{EvidenceError, Result};
use crate::opinion::{Kind, mean_earned};

/// Summaries of the latest episodes that a policy trained on, by which its task group is
/// recognised.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Memory {
    pub(crate) accounts: VecDeque<Account>,
    /// `false` for a policy that was created for episodes of others and did not train yet.
    pub(crate) is_trained: bool,
    /// Mean return of the first rollout that the policy trained on.
    pub(crate) beginning: Option<f64>,
    /// Indices of the policies that were compared with this one and serve other task groups.
    pub(crate) apart: Vec<usize>,
    /// Index of the policy that this one was merged into, which now acts for its task group.
    pub(crate) heir: Option<usize>,
}

impl Memory {
    /// Returns `true` if the policy was merged into another one.
    pub(crate) fn is_gone(&self) -> bool {
        self.heir.is_some()
    }

    /// Records that the policy trains on the episodes `accounts`; keeps the latest `most`.
    pub(crate) fn learn(&mut self, accounts: Vec<&Account>, most: usize) {
        let earned = mean_earned(accounts.iter().copied());
        if !self.is_trained {
            // a policy may train on a rollout that it was created for, and remembers it already
            self.accounts.retain(|account| !accounts.contains(&account));
        }
        self.beginning = self.beginning.or(earned);
        self.is_trained = true;
        self.remember(accounts.into_iter().cloned(), most);
    }

    /// Appends summaries of episodes and keeps the latest `most` of all.
    pub(crate) fn remember(&mut self, accounts: impl Iterator<Item = Account>, most: usize) {
        self.accounts.extend(accounts);
        let too_many = self.accounts.len().saturating_sub(most);
        self.accounts.drain(..too_many);
    }

    /// Returns the remembered episodes that new ones are compared with: the later half if the
    /// policy earns more there, since training has changed its behaviour, and all otherwise.
    pub(crate) fn home(&self) -> Vec<&Account> {
        let all: Vec<&Account> = self.accounts.iter().collect();
        let (before, late) = all.split_at(all.len() / 2);
        let means = mean_earned(before.iter().copied()).zip(mean_earned(late.iter().copied()));
        match means {
            Some((earlier, mean)) if mean - earlier > IMPROVES * spread(&all) => late.to_vec(),
            _ => all,
        }
    }

    /// Returns the gain in return since the first rollout, in standard deviations of the present
    /// returns, at least 0. The larger it is, the more surely a loss shows.
    pub(crate) fn gain(&self) -> f64 {
        self.gain_of(&self.home())
    }

    /// Returns by how much the return of `accounts` exceeds that of the policy's first rollout, in
    /// standard deviations of the former, at least 0; 0 if either return is unknown.
    pub(crate) fn gain_of(&self, accounts: &[&Account]) -> f64 {
        match (self.beginning, mean_earned(accounts.iter().copied())) {
            (Some(beginning), Some(earned)) => {
                let spread = spread(accounts).max(f64::MIN_POSITIVE);
                ((earned - beginning) / spread).clamp(0.0, f64::MAX)
            }
            _ => 0.0,
        }
    }

    /// Returns the share of the policy's gain in return that the episodes `accounts` did not earn,
    /// 0 without a gain. It is at most 1 for episodes that earn what the first rollout earned.
    pub(crate) fn lost(&self, accounts: &[&Account]) -> f64 {
        let now = mean_earned(accounts.iter().copied());
        match self.worth().zip(now) {
            Some(((home, worth), now)) => (home - now) / worth,
            None => 0.0,
        }
    }

    /// Returns the standard error of [`lost`](Self::lost), the share of the gain in return that was
    /// lost.
    pub(crate) fn lost_error(&self, accounts: &[&Account]) -> f64 {
        let home = self.home();
        let variance = |of: &[&Account]| spread(of).powi(2) / of.len().max(1) as f64;
        let error = (variance(accounts) + variance(&home)).sqrt();
        self.worth().map_or(0.0, |(_, worth)| error / worth)
    }

    /// Returns the mean return of the policy's remembered episodes and its rise since the first
    /// rollout; `None` if it did not rise.
    fn worth(&self) -> Option<(f64, f64)> {
        let home = mean_earned(self.home().into_iter())?;
        let gain = home - self.beginning?;
        // at least half of the return, or noise would be a large share of a small gain
        (gain > 0.0).then(|| (home, gain.max(home.abs() / 2.0)))
    }
}

/// Number of standard deviations by which the later half of a policy's returns must be higher to
/// count as progress.
const IMPROVES: f64 = 0.5;

/// Returns the standard deviation of the known returns; 0 if there are none.
fn spread(accounts: &[&Account]) -> f64 {
    let Some(mean) = mean_earned(accounts.iter().copied()) else {
        return 0.0;
    };
    let squares = accounts.iter().filter_map(|a| a.earned).map(|e| (f64::from(e) - mean).powi(2));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), s| (sum + s, count + 1.0));
    f64::sqrt(sum / count)
}

/// Rejects memories in which following merges from a policy never ends.
pub(crate) fn check_heirs(memories: &[Memory]) -> Result<()> {
    let heir = |&policy: &usize| memories[policy].heir;
    // without a circle, a chain of merges visits each policy at most once
    let circles =
        |policy: &usize| std::iter::successors(Some(*policy), heir).nth(memories.len()).is_some();
    match (0..memories.len()).find(circles) {
        Some(policy) => Err(EvidenceError::HeirsInCircle { policy }),
        None => Ok(()),
    }
}

/// Returns the remembered summaries of all policies.
pub(crate) fn known(memories: &[Memory]) -> impl Iterator<Item = &Account> + Clone {
    memories.iter().flat_map(|memory| &memory.accounts)
}

/// Checks that summaries can be compared: all numbers are finite, and each source has one length.
pub(crate) fn check<'a>(accounts: impl Iterator<Item = &'a Account> + Clone) -> Result<()> {
    for &kind in Kind::ALL {
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

/// Checks that a number is finite.
pub(crate) fn finite(what: &'static str, value: f64) -> Result<()> {
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
    fn a_gain_can_be_lost_and_noise_is_no_loss() {
        assert!(lost(100.0, 101.0, 99.5) < 0.05);
        assert!(lost(-101.0, -100.0, -101.5) < 0.05);
        assert_eq!(lost(0.0, 100.0, 60.0), 0.4);
        assert_eq!(lost(-20.0, -4.0, -12.0), 0.5);
        assert!(lost(0.0, 100.0, 110.0) < 0.0, "more than at home");
        assert_eq!(lost(100.0, 100.0, 10.0), 0.0, "no gain");
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

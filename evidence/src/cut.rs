//! A rollout that straddles a switch is cut between two episodes.

use cluster::change_test;
use rand::Rng;

use crate::account::Account;
use crate::error::EvidenceError;
use crate::opinion::{Kind, frames, whole};
use crate::settings::RecogniserSettings;

/// Random orders of a test, for each random split of a first look: they cost next to nothing.
const ORDERS: usize = 4;

/// The number of accounts, in the order in which their episodes began, that show another group than
/// the rest; none where one group explains all. Episodes that began together stay together.
///
/// Bounded in time: only the latest accounts are looked at, twice as many as a policy remembers.
pub(crate) fn find_cut<R: Rng + ?Sized>(
    accounts: &[&Account],
    settings: &RecogniserSettings,
    rng: &mut R,
) -> Result<Option<usize>, EvidenceError> {
    let latest = &accounts[accounts.len().saturating_sub(2 * settings.memory)..];
    let (kinds, seen) = match whole(latest, settings.min_episodes) {
        Some(seen) => (Kind::ALL.to_vec(), seen),
        None => (Kind::LOOKS.to_vec(), latest.to_vec()),
    };
    let cuts = places(&seen, settings.min_episodes);
    if cuts.is_empty() {
        return Ok(None);
    }
    let all = kinds.iter().map(|&kind| frames(&seen, kind));
    let all = all.collect::<Result<Vec<_>, _>>()?;
    let test = change_test(&all, &cuts, ORDERS * settings.permutations, rng)?;
    let began = seen[test.cut].began;
    let cut = accounts.partition_point(|account| account.began < began);
    Ok((test.p_value <= settings.cut).then_some(cut))
}

/// Where these accounts may be cut, with at least `least` on either side.
fn places(accounts: &[&Account], least: usize) -> Vec<usize> {
    let begins = |at: &usize| accounts[*at].began != accounts[*at - 1].began;
    let last = (accounts.len() + 1).saturating_sub(least);
    (least.max(1)..last).filter(begins).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accounts(began: impl Iterator<Item = usize>) -> Vec<Account> {
        let account = |began| Account {
            began,
            picture: vec![0.0],
            vector: vec![0.0],
            motion: None,
            slope: None,
            earned: None,
        };
        began.map(account).collect()
    }

    fn places_of(began: impl Iterator<Item = usize>) -> Vec<usize> {
        let accounts = accounts(began);
        places(&accounts.iter().collect::<Vec<_>>(), 4)
    }

    #[test]
    fn both_sides_of_a_place_show_enough_episodes() {
        assert_eq!(places_of(0..9), [4, 5]);
        assert_eq!(places_of((0..20).map(|i| i / 5)), [5, 10, 15]);
        assert!(places_of((0..9).map(|i| i / 3)).is_empty());
        assert!(places_of(0..3).is_empty() && places_of(0..0).is_empty());
    }
}

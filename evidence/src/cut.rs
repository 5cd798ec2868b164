//! A rollout that straddles a switch is cut between two episodes.

use cluster::{change_places, change_test};
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
    let began: Vec<_> = seen.iter().map(|account| account.began).collect();
    let cuts = change_places(&began, settings.min_episodes);
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

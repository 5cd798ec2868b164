//! A rollout that straddles a switch is cut between two episodes.

use cluster::change_test;
use rand::Rng;

use crate::account::Account;
use crate::error::EvidenceError;
use crate::opinion::{frames, sources_of};

/// The number of accounts, in the order in which their episodes began, that show another group than
/// the rest; none where one group explains all. Episodes that began together stay together.
pub(crate) fn find_cut<R: Rng + ?Sized>(
    accounts: &[&Account],
    level: f64,
    permutations: usize,
    rng: &mut R,
) -> Result<Option<usize>, EvidenceError> {
    let begins = |at: &usize| accounts[*at].began != accounts[*at - 1].began;
    let cuts: Vec<usize> = (1..accounts.len()).filter(begins).collect();
    if cuts.is_empty() {
        return Ok(None);
    }
    let kinds = sources_of(accounts, &[], true);
    let all = kinds.iter().map(|&kind| frames(accounts, kind));
    let all = all.collect::<Result<Vec<_>, _>>()?;
    let test = change_test(&all, &cuts, permutations, rng)?;
    Ok((test.p_value <= level).then_some(test.cut))
}

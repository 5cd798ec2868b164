//! Two policies that turn out to serve one group become one.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::account::Account;
use crate::error::EvidenceError;
use crate::examiner::Examiner;
use crate::memory::Memory;
use crate::opinion::{Look, Opinion, Role};
use crate::recogniser::Recogniser;

/// What becomes of two policies that serve one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Merge {
    /// The one that acts for both: it goes on as it is, under its number.
    pub kept: usize,
    /// The other one, which is kept as it is and asked again before a new policy is opened.
    pub gone: usize,
}

impl Recogniser {
    /// Returns a policy that may serve the group of `policy`: it is one of those that the last
    /// finding `accepted`, both have learnt, and the two were never compared. Let it act for some
    /// episodes of that group and [`Recogniser::compare`] them. Two that differ are not compared
    /// again.
    pub fn twin(&self, policy: usize, accepted: &[usize]) -> Option<usize> {
        let examiner = Examiner(self.settings());
        let own = self.memories.get(policy)?;
        let may_be = |twin: &usize| {
            let others = |memory| !Memory::is_gone(memory) && examiner.has_learnt(memory);
            *twin != policy
                && !own.apart.contains(twin)
                && self.memories.get(*twin).is_some_and(others)
        };
        let twin = accepted.iter().copied().find(may_be);
        twin.filter(|_| examiner.knows(own))
    }

    /// Whether `twin` earned in the group of `policy` what it earns at home, and about what
    /// `policy` earns there, judged by episodes in which it acted itself; what was found is
    /// remembered. If it did, let `policy` act once more, and [`Recogniser::merge`] them: the group
    /// may have changed before `twin` acted.
    ///
    /// # Errors
    /// Too few episodes, no such policies, or points that cannot be compared.
    pub fn compare<R: Rng + ?Sized>(
        &mut self,
        policy: usize,
        twin: usize,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<bool, EvidenceError> {
        self.check_policy(policy)?;
        let examiner = Examiner(self.settings());
        let opinion = self.opinion_of(twin, accounts, rng)?;
        // nor may the one that is at home earn much more there
        let lags = self.lost(policy, accounts) >= self.settings().min_loss;
        let is_twin = !lags && !opinion.is_refused() && examiner.is_proven(&opinion);
        if !is_twin {
            self.part(policy, twin);
        }
        Ok(is_twin)
    }

    /// Makes `twin` the heir of `policy`, in whose group [`Recogniser::compare`] found by `heard`
    /// that it serves, if `policy` serves still in the episodes `again`, in which it acted itself.
    /// Else they may be compared again. It is `twin` that goes on, since nobody heard `policy` at
    /// the home of `twin`; but where `policy` earns clearly more, `policy` goes on and is the heir.
    ///
    /// # Errors
    /// Those of [`Recogniser::compare`].
    pub fn merge<R: Rng + ?Sized>(
        &mut self,
        policy: usize,
        twin: usize,
        (heard, again): (&[Account], &[Account]),
        rng: &mut R,
    ) -> Result<Option<Merge>, EvidenceError> {
        self.check_policy(policy)?;
        self.check_policy(twin)?;
        if policy == twin || self.memories[policy].is_gone() || self.memories[twin].is_gone() {
            return Ok(None);
        }
        let opinion = self.opinion_of(policy, again, rng)?;
        if opinion.is_refused() || !Examiner(self.settings()).keeps(&opinion) {
            return Ok(None);
        }
        let lost = self.lost(policy, heard);
        let (kept, gone) =
            if Examiner(self.settings()).is_loss(lost) { (policy, twin) } else { (twin, policy) };
        self.memories[gone].heir = Some(kept);
        let apart = self.memories[gone].apart.clone();
        self.memories[kept].apart.extend(apart);
        Ok(Some(Merge { kept, gone }))
    }

    /// The share of what `policy` has learnt to earn that these episodes did not pay.
    fn lost(&self, policy: usize, accounts: &[Account]) -> f64 {
        let accounts: Vec<&Account> = accounts.iter().collect();
        self.memories[policy].lost(&accounts)
    }

    /// For each policy the one that acts for its group, too, since the two were merged.
    pub fn heirs(&self) -> Vec<Option<usize>> {
        self.memories.iter().map(|memory| memory.heir).collect()
    }

    /// Takes a policy that is about to learn for one that is asked; it was not what its heir is.
    pub(crate) fn revive(&mut self, policy: usize) {
        if let Some(heir) = self.memories[policy].heir.take() {
            self.part(policy, heir);
        }
    }

    /// What speaks for and against a policy that acted in these episodes itself.
    fn opinion_of<R: Rng + ?Sized>(
        &self,
        policy: usize,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<Opinion, EvidenceError> {
        self.check_policy(policy)?;
        let accounts = self.in_order(accounts)?;
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        let (examiner, memory) = (Examiner(self.settings()), &self.memories[policy]);
        examiner.opine(memory, &accounts, Role::Returns, Look::Second, &mut own)
    }

    /// Remembers that two policies serve different groups, as far as is known.
    fn part(&mut self, policy: usize, twin: usize) {
        self.memories[policy].apart.push(twin);
        self.memories[twin].apart.push(policy);
    }
}

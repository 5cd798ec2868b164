//! Merges of two policies that turn out to serve one task group.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::account::Account;
use crate::error::Result;
use crate::memory::Memory;
use crate::opinion::{Look, Opinion, Role};
use crate::recogniser::Recogniser;

impl Recogniser {
    /// Returns the index of a policy that may serve the same task group as `policy`. It is the
    /// first one that the last decision `accepted`, that has a gain, was not merged, and was not
    /// found to differ before. `None` if there is none, or if the gain of `policy` is too small for
    /// a proof. Let it act for some episodes of that group, then call [`Recogniser::compare`].
    pub fn twin(&self, policy: usize, accepted: &[usize]) -> Option<usize> {
        let examiner = self.examiner();
        let own = self.memories.get(policy)?;
        let may_be = |twin: &usize| {
            let others = |memory| !Memory::is_gone(memory) && examiner.has_gain(memory);
            *twin != policy
                && !own.apart.contains(twin)
                && self.memories.get(*twin).is_some_and(others)
        };
        let twin = accepted.iter().copied().find(may_be);
        twin.filter(|_| examiner.has_proven_gain(own))
    }

    /// Returns `true` if `twin`, which acted in these episodes of the task group of `policy`,
    /// earned about as much as in its own group and as `policy` does. Then let `policy` act once
    /// more, since the group may have changed before `twin` acted, and call [`Recogniser::merge`].
    /// Two policies that differ are not proposed again.
    ///
    /// # Errors
    /// Too few episodes, unknown policies, or episodes that cannot be compared.
    pub fn compare(
        &mut self,
        policy: usize,
        twin: usize,
        accounts: &[Account],
        rng: &mut impl Rng,
    ) -> Result<bool> {
        self.check_policy(policy)?;
        let opinion = self.opinion_of(twin, accounts, rng)?;
        // a policy that clearly earns more in its own group must keep it
        let lags = self.lost(policy, accounts) >= self.settings().min_loss;
        let is_twin = !lags && !opinion.is_rejected() && self.examiner().is_proven(&opinion);
        if !is_twin {
            self.part(policy, twin);
        }
        Ok(is_twin)
    }

    /// Merges `policy` into `twin`, which [`Recogniser::compare`] accepted by the episodes
    /// `of_twin`, if `policy` still serves its group in the episodes `again`, in which it acted
    /// itself. If `policy` earned clearly more in its own group than `twin` did, `twin` is merged
    /// into `policy` instead. If nothing was merged, the two may be compared again.
    ///
    /// # Errors
    /// Errors of [`Recogniser::compare`].
    pub fn merge(
        &mut self,
        policy: usize,
        twin: usize,
        of_twin: &[Account],
        again: &[Account],
        rng: &mut impl Rng,
    ) -> Result<()> {
        self.check_policy(policy)?;
        self.check_policy(twin)?;
        if policy == twin || self.memories[policy].is_gone() || self.memories[twin].is_gone() {
            return Ok(());
        }
        let opinion = self.opinion_of(policy, again, rng)?;
        if opinion.is_rejected() || !self.examiner().keeps(&opinion) {
            return Ok(());
        }
        // `twin` has served in both groups, `policy` never acted in the group of `twin`
        let is_loss = self.examiner().is_loss(self.lost(policy, of_twin));
        let (kept, gone) = if is_loss { (policy, twin) } else { (twin, policy) };
        self.memories[gone].heir = Some(kept);
        let apart = self.memories[gone].apart.clone();
        self.memories[kept].apart.extend(apart);
        Ok(())
    }

    /// Returns the share of the gain in return of `policy` that the episodes `accounts` did not
    /// earn.
    fn lost(&self, policy: usize, accounts: &[Account]) -> f64 {
        let accounts: Vec<&Account> = accounts.iter().collect();
        self.memories[policy].lost(&accounts)
    }

    /// Returns for each policy the index of the policy that it was merged into, if any.
    pub fn heirs(&self) -> Vec<Option<usize>> {
        self.memories.iter().map(|memory| memory.heir).collect()
    }

    /// Undoes the merge of a policy that is about to train on a group of its own.
    pub(crate) fn revive(&mut self, policy: usize) {
        if let Some(heir) = self.memories[policy].heir.take() {
            self.part(policy, heir);
        }
    }

    /// Tests a policy by episodes `accounts` in which it acted itself.
    fn opinion_of(
        &self,
        policy: usize,
        accounts: &[Account],
        rng: &mut impl Rng,
    ) -> Result<Opinion> {
        self.check_policy(policy)?;
        let accounts = self.in_order(accounts)?;
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        let memory = &self.memories[policy];
        self.examiner().opine(memory, &accounts, Role::Returns, Look::Second, &mut own)
    }

    /// Records that two policies serve different groups.
    fn part(&mut self, policy: usize, twin: usize) {
        self.memories[policy].apart.push(twin);
        self.memories[twin].apart.push(policy);
    }
}

//! Two policies that turn out to serve one group become one.

use cluster::Verdict;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::account::Account;
use crate::error::EvidenceError;
use crate::examiner::Examiner;
use crate::memory::mean_home;
use crate::opinion::{Look, Opinion, Role};
use crate::recogniser::{Finding, Recogniser};

/// What becomes of two policies that serve one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Merge {
    /// The one that earns more: it goes on as it is, under its number.
    pub kept: usize,
    /// The other one: it is not asked again.
    pub gone: usize,
}

impl Recogniser {
    /// A policy that may serve the group of `policy`, which `finding` accepted: it looks alike
    /// there, both have learnt, and the two were never compared. Let it act for some episodes of
    /// that group and [`Recogniser::compare`] them. Each two policies are compared once.
    pub fn twin(&self, policy: usize, finding: &Finding) -> Option<usize> {
        let examiner = Examiner(self.settings());
        let own = self.memories.get(policy)?;
        let may_be = |twin: &usize| {
            let (memory, opinion) = (&self.memories[*twin], &finding.opinions[*twin]);
            *twin != policy
                && opinion.verdict() == Verdict::Accepted
                && !memory.is_gone
                && !own.apart.contains(twin)
                && examiner.has_learnt(memory)
        };
        let known = finding.opinions.len().min(self.memories.len());
        (0..known).find(may_be).filter(|_| examiner.knows(own))
    }

    /// Whether `twin` earned in the group of `policy` what it earns at home, and about what `policy`
    /// earns there, judged by episodes in which it acted itself; what was found is remembered. If it
    /// did, let `policy` act once more, and [`Recogniser::merge`] them: the group may have changed
    /// before `twin` acted.
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
        let earned: Vec<&Account> = accounts.iter().collect();
        let lags = self.memories[policy].lost(&earned) >= self.settings().min_loss;
        let is_twin = !lags && !opinion.is_refused() && examiner.is_proven(&opinion);
        if !is_twin {
            self.part(policy, twin);
        }
        Ok(is_twin)
    }

    /// Makes one of two policies that [`Recogniser::compare`] found to serve one group, if `policy`
    /// serves it still in these episodes, in which it acted itself.
    ///
    /// # Errors
    /// Those of [`Recogniser::compare`].
    pub fn merge<R: Rng + ?Sized>(
        &mut self,
        policy: usize,
        twin: usize,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<Option<Merge>, EvidenceError> {
        self.check_policy(twin)?;
        if policy == twin || self.memories[policy].is_gone || self.memories[twin].is_gone {
            return Ok(None);
        }
        let opinion = self.opinion_of(policy, accounts, rng)?;
        if opinion.is_refused() || !Examiner(self.settings()).keeps(&opinion) {
            return Ok(None);
        }
        let earns = |policy: usize| mean_home(&self.memories[policy]).unwrap_or(f64::NEG_INFINITY);
        let (kept, gone) = match earns(twin) > earns(policy) {
            true => (twin, policy),
            false => (policy, twin),
        };
        self.memories[gone].is_gone = true;
        let apart = std::mem::take(&mut self.memories[gone].apart);
        self.memories[kept].apart.extend(apart);
        Ok(Some(Merge { kept, gone }))
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

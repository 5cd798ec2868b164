//! Merges of two policies that turn out to serve one task group.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::error::Result;
use crate::memory::PolicyMemory;
use crate::policy_test::{PolicyRole, PolicyTestResult, TestStage};
use crate::recogniser::Recogniser;
use crate::summary::EpisodeSummary;

impl Recogniser {
    /// Returns the first of the policies `accepted` that may serve the same task group as `policy`:
    /// one that has a gain in return, was not merged, and was not found to differ before; `None` if
    /// there is none, or if the gain of `policy` is too small for a proof. `accepted` are the
    /// policies that the last decision accepted. Let the duplicate act for some episodes of that
    /// group, then call [`Recogniser::confirm_duplicate`].
    pub fn find_possible_duplicate(&self, policy: usize, accepted: &[usize]) -> Option<usize> {
        let tester = self.tester();
        let own = self.memories.get(policy).filter(|own| tester.has_proven_gain(own.gain()))?;
        let may_serve =
            |memory: &PolicyMemory| !memory.is_merged() && tester.has_gain(memory.gain());
        accepted.iter().copied().find(|other| {
            *other != policy
                && !own.distinct_from.contains(other)
                && self.memories.get(*other).is_some_and(may_serve)
        })
    }

    /// Returns `true` if the policy `duplicate`, which acted in the episodes `summaries` of the
    /// task group of `policy`, got about the return that it gets in its own group and that `policy`
    /// gets in this one; otherwise the two are not proposed again. After `true`, let `policy` act
    /// once more, since the group may have changed before `duplicate` acted, and call
    /// [`Recogniser::recheck_and_merge`].
    ///
    /// # Errors
    /// Too few episodes, unknown policies, or episodes that cannot be compared.
    pub fn confirm_duplicate(
        &mut self,
        policy: usize,
        duplicate: usize,
        summaries: &[EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<bool> {
        self.check_policy(policy)?;
        let test = self.test_collector(duplicate, summaries, rng)?;
        // a policy that clearly has higher returns in its own group must keep it
        let is_worse = self.return_loss(policy, summaries) >= self.settings().min_loss;
        let serves = !is_worse && !test.is_rejected() && self.tester().is_proven(&test);
        if !serves {
            self.mark_distinct(policy, duplicate);
        }
        Ok(serves)
    }

    /// Merges the policy `policy` into `duplicate`, or the reverse if `policy` had clearly higher
    /// returns in its own group, provided that `policy` still serves that group in the episodes
    /// `again`, which it collected itself. [`Recogniser::confirm_duplicate`] accepted `duplicate`
    /// by the episodes `of_duplicate`. If nothing was merged, the two may be compared again.
    ///
    /// # Errors
    /// Errors of [`Recogniser::confirm_duplicate`].
    pub fn recheck_and_merge(
        &mut self,
        policy: usize,
        duplicate: usize,
        of_duplicate: &[EpisodeSummary],
        again: &[EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<()> {
        self.check_policy(policy)?;
        self.check_policy(duplicate)?;
        let is_merged = |index: usize| self.memories[index].is_merged();
        if policy == duplicate || is_merged(policy) || is_merged(duplicate) {
            return Ok(());
        }
        // as many as its comparison needed
        self.in_order(of_duplicate)?;
        let test = self.test_collector(policy, again, rng)?;
        if test.is_rejected() || !self.tester().keeps_return(&test) {
            return Ok(());
        }
        // `duplicate` has served in both groups, `policy` never acted in the group of `duplicate`
        let is_loss = self.tester().is_loss(self.return_loss(policy, of_duplicate));
        let (kept, gone) = if is_loss { (policy, duplicate) } else { (duplicate, policy) };
        self.memories[gone].merged_into = Some(kept);
        let distinct_from = self.memories[gone].distinct_from.clone();
        self.memories[kept].distinct_from.extend(distinct_from);
        Ok(())
    }

    /// Returns the share of the gain in return of `policy` that is missing in the episodes.
    fn return_loss(&self, policy: usize, summaries: &[EpisodeSummary]) -> f64 {
        let summaries: Vec<&EpisodeSummary> = summaries.iter().collect();
        self.memories[policy].return_loss(&summaries)
    }

    /// Returns for each policy the index of the policy that it was merged into, if any.
    pub fn merged_into(&self) -> Vec<Option<usize>> {
        self.memories.iter().map(|memory| memory.merged_into).collect()
    }

    /// Undoes the merge of a policy into another one, as it will train on a group of its own.
    pub(crate) fn undo_merge(&mut self, policy: usize) {
        if let Some(other) = self.memories[policy].merged_into.take() {
            self.mark_distinct(policy, other);
        }
    }

    /// Tests a policy by episodes in which it acted itself.
    fn test_collector(
        &self,
        policy: usize,
        summaries: &[EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<PolicyTestResult> {
        self.check_policy(policy)?;
        let summaries = self.in_order(summaries)?;
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        let (memory, role) = (&self.memories[policy], PolicyRole::Returning);
        self.tester().test(memory, &summaries, role, TestStage::Confirmation, &mut own)
    }

    /// Records that two policies serve different groups.
    fn mark_distinct(&mut self, policy: usize, other: usize) {
        self.memories[policy].distinct_from.push(other);
        self.memories[other].distinct_from.push(policy);
    }
}

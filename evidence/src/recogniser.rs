//! Recogniser of task groups: remembers summaries of each policy's episodes, and decides which
//! policy new episodes belong to.

use std::collections::VecDeque;

use cluster::{AssignedPolicy, PolicyVerdict, changepoint_candidates, changepoint_test};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::choice::PolicyChoice;
use crate::error::{EvidenceError, Result};
use crate::memory::{PolicyMemory, all_summaries, check_comparable};
use crate::policy_test::{
    EvidenceSource, PolicyRole, PolicyTestResult, TestStage, frames, whole_episodes,
};
use crate::probability::{CandidatePolicy, TaskGroupProbabilities, weight};
use crate::settings::{CHANGEPOINT_ORDERS, RecogniserSettings};
use crate::summary::EpisodeSummary;
use crate::tester::PolicyTester;

/// Decision of a [`Recogniser`] on the policy of a rollout, with the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutDecision {
    /// Policy that the episodes are assigned to: an existing one, a new one, or none yet.
    pub policy: AssignedPolicy,
    /// Test of each policy, in the order of the policies.
    pub tests: Vec<PolicyTestResult>,
    /// Changepoint, in decisions of all environments since the start of the rollout, if the task
    /// group changed: episodes that began before it belong to the earlier group.
    /// [`Recogniser::assign_rollout`] judges the later episodes,
    /// [`Recogniser::review_proposed_policy`] the earlier ones, unless `group_changed`.
    pub changepoint: Option<usize>,
    /// `true` if the task group changed after the acting policy was proposed, so that earlier
    /// rollouts show another task group.
    pub group_changed: bool,
    /// Indices of the policies that are rejected for this task group from here on.
    pub rejected: Vec<usize>,
    /// Indices of the policies that images or vectors of the episodes reject at the final level.
    pub differing: Vec<usize>,
    /// Trial before the decision is final; none if it names the policy that acted.
    pub trial: RequiredTrial,
    /// `true` if the named policy is provisional: evidence from before it acted rejects it, because
    /// images or vectors differ or it was merged, so its returns must show that it serves the
    /// group.
    pub is_provisional: bool,
}

/// Trial before a decision is final. The policy that the decision names collects a rollout, or a
/// few episodes first, unless it acted already; waived where that would come too late. An undecided
/// decision may ask the policy that acted for a rollout with earlier parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RequiredTrial {
    /// No trial of the named policy: the decision is final.
    #[default]
    None,
    /// One rollout that the named policy collects itself.
    Rollout,
    /// A few episodes of the named policy first, as many as a decision needs and at least one in
    /// each environment, since several policies may fit; then one rollout.
    Episodes,
    /// No trial before the named policy trains, since it would come too late: the task group
    /// changed while another policy was on trial. The named policy trains on the rollout of that
    /// one. If that one only acted for a few episodes, the named policy collects a rollout for
    /// review.
    Waived,
    /// One rollout that the policy which acted collects with its parameters from before its latest
    /// update, of an undecided decision: that update may explain why motion or returns differ.
    PreviousParameters,
}

impl RequiredTrial {
    /// Returns the trial of a named policy: first episodes if several policies may fit, else a
    /// rollout.
    fn of_policy(is_contested: bool) -> Self {
        if is_contested { Self::Episodes } else { Self::Rollout }
    }
}

impl RolloutDecision {
    /// Returns the indices of the policies that the evidence accepts.
    pub fn accepted_policies(&self) -> Vec<usize> {
        let policies = 0..self.tests.len();
        policies.filter(|&policy| self.tests[policy].verdict == PolicyVerdict::Accepted).collect()
    }
}

/// Context of a decision on a rollout: the policy that acted, the rejected policies and earlier
/// decisions.
#[derive(Clone, Copy, Debug, Default)]
pub struct RolloutDecisionContext<'a> {
    /// Index of the policy that acted in the episodes.
    pub collector: usize,
    /// Indices of the policies that were rejected for the same task group before.
    pub rejected: &'a [usize],
    /// Value of [`RolloutDecision::differing`] in the decision that proposed the acting policy.
    pub differing: &'a [usize],
    /// Value of [`RolloutDecision::is_provisional`] in the decision that proposed the acting
    /// policy.
    pub is_provisional: bool,
    /// Availability of the acting policy's parameters from before its latest update.
    pub previous_parameters: PreviousParameters,
    /// `true` if the decision may be [`AssignedPolicy::Undecided`], so that another rollout is
    /// collected.
    pub allow_undecided: bool,
}

/// Availability of a policy's parameters from before its latest update. A policy that its latest
/// update made worse looks like one in a foreign group; if the earlier parameters still serve, the
/// group is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PreviousParameters {
    /// The policy cannot act with them.
    #[default]
    Unavailable,
    /// The policy can act with them in the next rollout.
    Available,
    /// The policy acted with them, as [`RequiredTrial::PreviousParameters`] asked.
    Acted,
}

impl RolloutDecisionContext<'_> {
    /// Creates the context of a rollout that the policy `collector` collected without being
    /// proposed for it: no policies are rejected, and the decision may be
    /// [`AssignedPolicy::Undecided`].
    pub fn for_collector(collector: usize) -> Self {
        Self { collector, allow_undecided: true, ..Self::default() }
    }
}

/// Episodes that a decision is about, sorted by time, and their context.
#[derive(Clone, Copy)]
pub(crate) struct Case<'a> {
    pub(crate) summaries: &'a [&'a EpisodeSummary],
    pub(crate) context: RolloutDecisionContext<'a>,
    /// `true` if the policy that acted collected some of the episodes with parameters from before
    /// its latest update.
    pub(crate) is_before_update: bool,
}

impl<'a> Case<'a> {
    pub(crate) fn new(
        summaries: &'a [&'a EpisodeSummary],
        context: RolloutDecisionContext<'a>,
    ) -> Self {
        let is_before_update = context.previous_parameters == PreviousParameters::Acted;
        Self { summaries, context, is_before_update }
    }
}

/// Largest number of undecided rollouts that are kept until another one of their task group
/// appears.
// A group that is visited once in 16 undecided rollouts is still found.
const MAX_UNDECIDED: usize = 16;

/// Least p-value at which two rollouts, or a rollout and a policy, are taken for one task group.
// A policy that is created from two groups serves neither, and a rollout that waits costs little:
// one of ten pairs of one group waits for a third rollout. Of 72 worlds with visits of one or two
// rollouts 82 % had as many policies as groups, 79 % with 0.2 and 47 % with 0.02 (seeds 1000 on).
pub(crate) const SAME_GROUP: f64 = 0.1;

/// Number of policies without training from which on rollouts of new task groups are kept undecided
/// instead of creating a policy.
const MAX_UNTRAINED: usize = 8;

/// Undecided rollout: no policy trained on it, since its episodes were too few to decide.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct UndecidedRollout {
    /// Index of the policy that acted in the undecided rollout.
    pub(crate) collector: usize,
    #[serde(rename = "accounts")]
    pub(crate) summaries: Vec<EpisodeSummary>,
    /// `true` if the policy that acted has trained since, so that its latest update cannot explain
    /// why the rollout was doubted.
    #[serde(default)]
    is_before_update: bool,
}

/// Recogniser of task groups: remembers the episodes that each policy trained on, and decides which
/// policy's task group new episodes belong to.
#[derive(Clone, Debug, PartialEq)]
pub struct Recogniser {
    settings: RecogniserSettings,
    pub(crate) memories: Vec<PolicyMemory>,
    /// Undecided rollouts that are kept, the latest last.
    pub(crate) undecided: VecDeque<UndecidedRollout>,
    /// Index of the policy that trained last.
    pub(crate) last_trained: Option<usize>,
}

impl Recogniser {
    /// Creates a recogniser that knows no policies yet.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: RecogniserSettings) -> Result<Self> {
        settings.check()?;
        Ok(Self { settings, memories: Vec::new(), undecided: VecDeque::new(), last_trained: None })
    }

    /// Returns the settings of the recogniser.
    pub fn settings(&self) -> &RecogniserSettings {
        &self.settings
    }

    /// Returns the number of known policies: those that trained or were created for episodes.
    pub fn policy_count(&self) -> usize {
        self.memories.len()
    }

    /// Remembers the summaries of the episodes that `policy` trains on, without those after a
    /// changepoint; returns the changepoint, if there is one. Summaries of episodes that another
    /// policy collected hold the first observation only
    /// ([`EpisodeSummary::keep_only_first_observation`]). A new policy has the index
    /// [`policy_count`](Self::policy_count). A merge of `policy` is undone. The changepoint is the
    /// number of decisions before the first episode that is left out.
    ///
    /// # Errors
    /// A larger index, no episode, numbers that are not finite, or lists whose length differs from
    /// the remembered ones. Nothing is remembered then.
    pub fn record_training(
        &mut self,
        policy: usize,
        summaries: &[EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<Option<usize>> {
        self.check_actor(policy)?;
        if summaries.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        check_comparable(all_summaries(&self.memories).chain(summaries))?;
        let mut summaries = sorted(summaries);
        let place = self.find_changepoint(&summaries, rng)?;
        let changepoint = place.map(|place| summaries[place].began);
        summaries.truncate(place.unwrap_or(summaries.len()));
        let is_outdated = self.is_outdated(policy, &summaries, rng)?;
        if policy == self.memories.len() {
            self.memories.push(PolicyMemory::default());
        }
        self.undo_merge(policy);
        self.last_trained = Some(policy);
        for kept in self.undecided.iter_mut().filter(|kept| kept.collector == policy) {
            kept.is_before_update = true;
        }
        let memory = &mut self.memories[policy];
        if is_outdated {
            memory.summaries.clear();
        }
        memory.record_training(summaries, self.settings.memory);
        Ok(changepoint)
    }

    /// Returns `true` if a policy's memory no longer matches the images or vectors that it is about
    /// to train on, because its group drifted while it was away.
    fn is_outdated(
        &self,
        policy: usize,
        summaries: &[&EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<bool> {
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        if summaries.len() < self.settings.min_episodes {
            return Ok(false);
        }
        let mut memory = self.memories.get(policy).cloned().unwrap_or_default();
        // training is about to undo a merge, which would otherwise count as a rejection
        memory.merged_into = None;
        let (role, stage) = (PolicyRole::Other, TestStage::Confirmation);
        Ok(self.tester().test(&memory, summaries, role, stage, &mut own)?.is_rejected())
    }

    /// Returns the index of the policy that should act in episodes that begin like `summaries`: that
    /// of an accepted policy which they fit much better than `current`, else `current`. Only first
    /// images and vectors count; with too few episodes for a test it is `current`, too.
    ///
    /// # Errors
    /// [`EvidenceError::NoPolicy`] for a current policy above [`policy_count`](Self::policy_count);
    /// episodes that cannot be compared.
    pub fn choose_collector(
        &self,
        summaries: &[EpisodeSummary],
        current: usize,
        rng: &mut impl Rng,
    ) -> Result<usize> {
        self.check_actor(current)?;
        check_comparable(all_summaries(&self.memories).chain(summaries))?;
        if summaries.len() < self.settings.min_episodes {
            return Ok(current);
        }
        let summaries: Vec<_> = summaries.iter().collect();
        let context = RolloutDecisionContext::for_collector(current);
        let case = Case::new(&summaries, context);
        let tests = self.test_all(case, TestStage::Screening, PolicyRole::Other, rng)?;
        let choice = PolicyChoice::new(&tests, current);
        // policies that look alike need a trial
        let is_only = choice.accepted_others().len() == 1;
        let other = choice.better_other().filter(|&p| is_only && self.may_replace(&choice, p));
        Ok(other.unwrap_or(current))
    }

    /// Decides which policy a rollout belongs to that the policy `context.collector` collected;
    /// remembers the episodes of a new policy and of an undecided rollout. `Existing` with another
    /// policy, and `New`, ask for a rollout of that policy and for
    /// [`Recogniser::review_proposed_policy`]. A rollout that is too little to decide is kept, and
    /// judged together with the next similar one. `Undecided`, if `context` allows it, asks for
    /// another rollout; no policy may train on this one. With
    /// [`RequiredTrial::PreviousParameters`] the policy that acted collects it with earlier
    /// parameters; if these are accepted, the undecided episodes are remembered, too. After a
    /// changepoint, only the later episodes count, but the policy that acted is named only if the
    /// earlier ones fit it, too, since it trains on those.
    ///
    /// # Errors
    /// [`EvidenceError::NoPolicy`] for a collector above [`policy_count`](Self::policy_count); too
    /// few episodes, or episodes that cannot be compared.
    pub fn assign_rollout(
        &mut self,
        summaries: &[EpisodeSummary],
        context: RolloutDecisionContext,
        rng: &mut impl Rng,
    ) -> Result<RolloutDecision> {
        self.check_actor(context.collector)?;
        check_comparable(all_summaries(&self.memories).chain(summaries))?;
        let summaries = self.in_order(summaries)?;
        let place = self.find_changepoint(&summaries, rng)?;
        let case = Case::new(&summaries[place.unwrap_or(0)..], context);
        let mut decision = self.screen(case, rng)?;
        let serves_as_before = place.is_none()
            && context.previous_parameters == PreviousParameters::Acted
            && decision.policy == AssignedPolicy::Existing(context.collector);
        if serves_as_before && decision.tests[context.collector].p_value() >= SAME_GROUP {
            self.remember_doubted_rollouts(context.collector);
        } else if serves_as_before || decision.policy == AssignedPolicy::Undecided {
            decision = self.decide_with_kept(case, decision, rng)?;
        }
        decision.changepoint = place.map(|place| summaries[place].began);
        // the acting policy would train on the part before the changepoint
        if let Some(place) = place
            && context.allow_undecided
            && decision.policy == AssignedPolicy::Existing(context.collector)
            && !self.fits_collector(
                Case { summaries: &summaries[..place], ..case },
                self.role_of_collector(context.collector),
                TestStage::Screening,
                rng,
            )?
        {
            decision.policy = AssignedPolicy::Undecided;
        }
        Ok(decision)
    }

    /// Returns `true` if the latest update of the policy that acted may explain why a decision asks
    /// for a new one: images and vectors are as remembered, and motion or returns differ, which
    /// depend on its parameters.
    fn update_may_explain(
        &self,
        context: RolloutDecisionContext,
        decision: &RolloutDecision,
    ) -> bool {
        let looks_alike =
            |own: &PolicyTestResult| !own.first_observation_differs(self.settings.doubt);
        decision.policy == AssignedPolicy::New
            && context.allow_undecided
            && context.previous_parameters == PreviousParameters::Available
            && decision.tests.get(context.collector).is_some_and(looks_alike)
    }

    /// Lets `policy` remember the rollouts that were kept last, which it collected since its latest
    /// update: the group is the same, and that update explains the difference.
    fn remember_doubted_rollouts(&mut self, policy: usize) {
        let is_doubted =
            |kept: &UndecidedRollout| kept.collector == policy && !kept.is_before_update;
        if self.undecided.back().is_some_and(is_doubted)
            && let Some(kept) = self.undecided.pop_back()
        {
            self.memories[policy].record_changing_update(kept.summaries);
        }
    }

    /// Returns `true` if the evidence accepts the policy that acted, in the given role and stage.
    pub(crate) fn fits_collector(
        &self,
        case: Case,
        role: PolicyRole,
        stage: TestStage,
        rng: &mut impl Rng,
    ) -> Result<bool> {
        let Some(memory) = self.memories.get(case.context.collector) else { return Ok(true) };
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        let test = self.tester().test(memory, case.summaries, role, stage, &mut own)?;
        Ok(test.verdict == PolicyVerdict::Accepted)
    }

    /// Returns the role of the policy `collector` in the assignment of a rollout that it collected.
    fn role_of_collector(&self, collector: usize) -> PolicyRole {
        if self.last_trained == Some(collector) {
            PolicyRole::Collector
        } else {
            PolicyRole::Returning
        }
    }

    /// Decides on episodes together with a kept undecided rollout of the same task group. Without
    /// such a rollout, the decision of the screening test holds, and undecided episodes are kept if
    /// the context allows it.
    pub(crate) fn decide_with_kept(
        &mut self,
        case: Case,
        screened: RolloutDecision,
        rng: &mut impl Rng,
    ) -> Result<RolloutDecision> {
        let collector = case.context.collector;
        let earlier = self.take_similar_undecided(case, rng)?;
        let of_collector = earlier.as_ref().filter(|kept| kept.collector == collector);
        let is_since_update = of_collector.is_some_and(|kept| !kept.is_before_update);
        let is_before_update =
            case.is_before_update || of_collector.is_some_and(|kept| kept.is_before_update);
        let earlier = earlier.map_or_else(Vec::new, |earlier| earlier.summaries);
        if earlier.is_empty() && case.context.allow_undecided {
            if screened.policy == AssignedPolicy::Undecided {
                self.keep_undecided(case);
            }
            return Ok(screened);
        }
        let all: Vec<_> = earlier.iter().chain(case.summaries.iter().copied()).collect();
        let case = Case { summaries: &all, is_before_update, ..case };
        let decision = self.decide(case, self.role_of_collector(collector), rng)?;
        if case.context.allow_undecided && self.knows_too_little(&decision, collector) {
            self.keep_undecided(case);
            return Ok(RolloutDecision { policy: AssignedPolicy::Undecided, ..decision });
        }
        if is_since_update && self.update_may_explain(case.context, &decision) {
            self.keep_undecided(case);
            let trial = RequiredTrial::PreviousParameters;
            return Ok(RolloutDecision { policy: AssignedPolicy::Undecided, trial, ..decision });
        }
        self.create_policy(case, decision)
    }

    /// Returns `true` if the acting policy remembers few episodes, and was accepted although images
    /// or vectors differ by more than drift explains: more episodes might reject it.
    fn knows_too_little(&self, decision: &RolloutDecision, collector: usize) -> bool {
        let Some((memory, test)) = self.memories.get(collector).zip(decision.tests.get(collector))
        else {
            return false;
        };
        let tester = self.tester();
        decision.policy == AssignedPolicy::Existing(collector)
            && 2 * memory.summaries.len() < self.settings.memory
            && test.first_observation_differs(self.settings.doubt)
            && test.first_observation_ratio() >= tester.least_ratio(test)
            && !tester.is_proven(test)
    }

    /// Creates the policy that a decision asks for, which remembers the images and vectors of the
    /// episodes. If there are `max_policies` already, the most similar one is named instead,
    /// without a trial. If too many wait for their first training, the episodes are kept.
    pub(crate) fn create_policy(
        &mut self,
        case: Case,
        decision: RolloutDecision,
    ) -> Result<RolloutDecision> {
        if decision.policy != AssignedPolicy::New {
            return Ok(decision);
        }
        if self.memories.len() >= self.settings.max_policies {
            let similar = self.most_similar(&decision.tests);
            let policy = AssignedPolicy::Existing(similar.unwrap_or(case.context.collector));
            return Ok(RolloutDecision { policy, trial: RequiredTrial::None, ..decision });
        }
        let untrained = self.memories.iter().filter(|memory| !memory.is_trained).count();
        if case.context.allow_undecided && untrained >= MAX_UNTRAINED {
            self.keep_undecided(case);
            return Ok(RolloutDecision { policy: AssignedPolicy::Undecided, ..decision });
        }
        let mut memory = PolicyMemory::default();
        let mut summaries: Vec<_> = case.summaries.iter().copied().cloned().collect();
        summaries.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        memory.append(summaries.into_iter(), self.settings.memory);
        self.memories.push(memory);
        Ok(decision)
    }

    /// Returns `true` if one rollout rejects the policy that acted for certain.
    fn rejects_collector(&self, choice: &PolicyChoice) -> bool {
        choice.collector_test().is_some_and(|own| self.tester().rejects_surely(own))
    }

    /// Returns `true` if it pays to try the accepted policy `other` in place of the one that acted.
    // Motion and returns under the acting policy are no evidence about others, so trying another
    // one costs a rollout: it pays off if the acting one is surely wrong or its images differ; in
    // other cases another rollout of it is cheaper. A second policy of this group, created by a
    // false alarm, looks right, too, but should not replace one that has learnt.
    fn may_replace(&self, choice: &PolicyChoice, other: usize) -> bool {
        let has_gain = |test: &PolicyTestResult| self.tester().has_gain(test.gain);
        let is_as_good =
            has_gain(choice.test(other)) || !choice.collector_test().is_some_and(has_gain);
        self.rejects_collector(choice)
            || (!choice.looks_familiar(self.settings.doubt) && is_as_good)
    }

    /// Returns the indices of the policies that images or vectors reject at the final level.
    fn differing_policies(&self, tests: &[PolicyTestResult]) -> Vec<usize> {
        let policies = 0..tests.len();
        policies.filter(|&policy| self.rejects_first_observation(&tests[policy])).collect()
    }

    /// Returns `true` if images or vectors reject a policy at the final level.
    pub(crate) fn rejects_first_observation(&self, test: &PolicyTestResult) -> bool {
        let mut sources = self.tester().rejecting_sources(test, self.settings.level);
        sources.any(EvidenceSource::is_first_observation)
    }

    /// Returns the index of the policy that fits best among those that were tested and not merged.
    fn most_similar(&self, tests: &[PolicyTestResult]) -> Option<usize> {
        let is_tested =
            |&policy: &usize| !self.memories[policy].is_merged() && tests[policy].test.is_some();
        let score = |policy: &usize| tests[*policy].outlier_score();
        (0..tests.len()).filter(is_tested).min_by(|a, b| score(a).total_cmp(&score(b)))
    }

    /// Decides on the policy of one rollout by screening tests.
    pub(crate) fn screen(&self, case: Case, rng: &mut impl Rng) -> Result<RolloutDecision> {
        let collector = case.context.collector;
        let role = self.role_of_collector(collector);
        let tests = self.test_all(case, TestStage::Screening, role, rng)?;
        let choice = PolicyChoice::new(&tests, collector);
        let others = choice.accepted_others();
        let is_familiar = choice.looks_familiar(self.settings.doubt);
        let is_rejected = self.rejects_collector(&choice);
        let other = others.iter().copied().find(|&policy| self.may_replace(&choice, policy));
        let named = choice.accepted_collector().or(other);
        Ok(RolloutDecision {
            policy: named.map_or(AssignedPolicy::Undecided, AssignedPolicy::Existing),
            changepoint: None,
            group_changed: false,
            rejected: is_rejected.then_some(collector).into_iter().collect(),
            differing: self.differing_policies(&tests),
            trial: RequiredTrial::of_policy(is_familiar || others.len() > 1),
            is_provisional: false,
            tests,
        })
    }

    /// Keeps an undecided rollout, or its latest `memory` episodes. The latest [`MAX_UNDECIDED`]
    /// rollouts are kept.
    fn keep_undecided(&mut self, case: Case) {
        while self.undecided.len() >= MAX_UNDECIDED {
            self.undecided.pop_front();
        }
        let first = case.summaries.len().saturating_sub(self.settings.memory);
        let summaries = case.summaries[first..].iter().copied().cloned().collect();
        let Case { context, is_before_update, .. } = case;
        let collector = context.collector;
        self.undecided.push_back(UndecidedRollout { collector, summaries, is_before_update });
    }

    /// Removes and returns the kept undecided rollout that is most similar to the episodes of
    /// `case`, if it may be of the same task group; otherwise nothing.
    fn take_similar_undecided(
        &mut self,
        case: Case,
        rng: &mut impl Rng,
    ) -> Result<Option<UndecidedRollout>> {
        let collector = case.context.collector;
        let (mut own, mut best) = (ChaCha8Rng::seed_from_u64(rng.random()), None);
        for (index, kept) in self.undecided.iter().enumerate() {
            let summaries = kept.summaries.clone().into();
            let memory = PolicyMemory { summaries, ..PolicyMemory::default() };
            // motion and returns depend on the parameters that acted
            let acts_alike = kept.collector == collector
                && case.context.previous_parameters != PreviousParameters::Acted;
            let role = if acts_alike { PolicyRole::Collector } else { PolicyRole::Other };
            let stage = TestStage::Screening;
            let result = self.tester().test(&memory, case.summaries, role, stage, &mut own)?;
            let score = result.first_observation_score();
            let may_be_same = result.test.is_some() && result.p_value() >= SAME_GROUP;
            if may_be_same && best.is_none_or(|(_, least)| score < least) {
                best = Some((index, score));
            }
        }
        let mut found = best.and_then(|(index, _)| self.undecided.remove(index));
        if let Some(kept) = found.as_mut().filter(|kept| kept.collector != collector) {
            kept.summaries.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        }
        Ok(found)
    }

    /// Returns the probability that episodes belong to each policy's task group, from the first
    /// images and vectors of at least one episode, whichever policy acted.
    ///
    /// # Errors
    /// No episode, or episodes that cannot be compared.
    pub fn task_group_probabilities(
        &self,
        summaries: &[EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<TaskGroupProbabilities> {
        if summaries.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        check_comparable(all_summaries(&self.memories).chain(summaries))?;
        let summaries: Vec<_> = summaries.iter().collect();
        // an index beyond all policies: none of them acted
        let context = RolloutDecisionContext::for_collector(self.memories.len());
        let case = Case::new(&summaries, context);
        let tests = self.test_all(case, TestStage::Confirmation, PolicyRole::Other, rng)?;
        let candidates = tests.iter().zip(&self.memories).map(|(test, memory)| {
            let mut rejecting = self.tester().rejecting_sources(test, self.settings.doubt);
            let may_be_drift = rejecting.next().is_none();
            let is_known = test.test.is_some() && !memory.is_merged();
            CandidatePolicy {
                weight: if is_known { weight(test.tail_p_value(), may_be_drift) } else { 0.0 },
                outlier_score: test.outlier_score(),
                has_gain: self.tester().has_gain(test.gain),
            }
        });
        Ok(TaskGroupProbabilities::new(candidates.collect()))
    }

    /// Returns a tester of policies with the settings of the recogniser.
    pub(crate) fn tester(&self) -> PolicyTester<'_> {
        PolicyTester(&self.settings)
    }

    /// Checks that an acting policy's index is known, or that of the next new policy.
    fn check_actor(&self, policy: usize) -> Result<()> {
        if policy == self.memories.len() { Ok(()) } else { self.check_policy(policy) }
    }

    /// Rejects the index of a policy that the recogniser does not know.
    pub(crate) fn check_policy(&self, policy: usize) -> Result<()> {
        let policies = self.memories.len();
        if policy < policies { Ok(()) } else { Err(EvidenceError::NoPolicy { policy, policies }) }
    }

    /// Returns episode summaries sorted by time; an error if they are too few for a test.
    pub(crate) fn in_order<'a>(
        &self,
        summaries: &'a [EpisodeSummary],
    ) -> Result<Vec<&'a EpisodeSummary>> {
        let (got, needed) = (summaries.len(), self.settings.min_episodes);
        if got < needed {
            return Err(EvidenceError::TooFewEpisodes { got, needed });
        }
        Ok(sorted(summaries))
    }

    /// Tests all policies in parallel: the acting one in the given role, the others as
    /// [`PolicyRole::Other`].
    fn test_all(
        &self,
        case: Case,
        stage: TestStage,
        role: PolicyRole,
        rng: &mut impl Rng,
    ) -> Result<Vec<PolicyTestResult>> {
        // each policy has its own generator, so the result does not depend on threads
        let seeds: Vec<u64> = self.memories.iter().map(|_| rng.random()).collect();
        let Case { summaries, context, .. } = case;
        let tests = seeds.into_par_iter().enumerate().map(|(policy, seed)| {
            let role = if policy == context.collector { role } else { PolicyRole::Other };
            let (memory, mut own) = (&self.memories[policy], ChaCha8Rng::seed_from_u64(seed));
            let mut result = self.tester().test(memory, summaries, role, stage, &mut own)?;
            if context.rejected.contains(&policy) {
                result.verdict = PolicyVerdict::Rejected;
            }
            Ok(result)
        });
        tests.collect()
    }

    /// Decides finally on the policy of two rollouts or of a trial.
    pub(crate) fn decide(
        &self,
        case: Case,
        role: PolicyRole,
        rng: &mut impl Rng,
    ) -> Result<RolloutDecision> {
        let RolloutDecisionContext { collector, rejected, .. } = case.context;
        let tests = self.test_all(case, TestStage::Confirmation, role, rng)?;
        let choice = PolicyChoice::new(&tests, collector);
        let others = choice.accepted_others();
        let accepted = choice.accepted_collector().or_else(|| others.first().copied());
        let (tester, memories) = (self.tester(), &self.memories);
        // a policy that images reject is proposed if it did not act and was not tried before
        let is_eligible = |policy| policy != collector && !rejected.contains(&policy);
        let can_prove = |policy: usize| tester.has_proven_gain(tests[policy].gain);
        let are_merged = |a: usize, b: usize| {
            memories[a].merged_into == Some(b) || memories[b].merged_into == Some(a)
        };
        let (max, max_isolated) = (tester.max_drift(), tester.max_isolated_drift());
        let drifted = || choice.drifted(max, max_isolated, is_eligible, can_prove, are_merged);
        let named = accepted.or_else(drifted);
        // merged policies stay eligible until they were tried
        let is_rejected = |&policy: &usize| {
            let is_tried = !memories[policy].is_merged() || rejected.contains(&policy);
            tests[policy].is_rejected() && named != Some(policy) && is_tried
        };
        let is_familiar = choice.looks_familiar(self.settings.doubt);
        Ok(RolloutDecision {
            policy: named.map_or(AssignedPolicy::New, AssignedPolicy::Existing),
            changepoint: None,
            group_changed: false,
            rejected: (0..tests.len()).filter(is_rejected).collect(),
            differing: self.differing_policies(&tests),
            trial: RequiredTrial::of_policy(is_familiar || others.len() != 1),
            is_provisional: named.is_some_and(|policy| tests[policy].is_rejected()),
            tests,
        })
    }

    /// Returns the number of episodes, sorted by time, before a changepoint; `None` if there is
    /// none. Episodes that began together stay together.
    ///
    /// Only the latest summaries are tested, twice as many as a policy remembers, to bound the
    /// time.
    pub(crate) fn find_changepoint(
        &self,
        summaries: &[&EpisodeSummary],
        rng: &mut impl Rng,
    ) -> Result<Option<usize>> {
        let RecogniserSettings { memory, min_episodes, permutations, .. } = self.settings;
        let latest = &summaries[summaries.len().saturating_sub(2 * memory)..];
        let (sources, seen) = match whole_episodes(latest, min_episodes) {
            Some(seen) => (EvidenceSource::ALL, seen),
            None => (EvidenceSource::FIRST_OBSERVATION, latest.to_vec()),
        };
        let began: Vec<_> = seen.iter().map(|summary| summary.began).collect();
        let candidates = changepoint_candidates(&began, min_episodes);
        if candidates.is_empty() {
            return Ok(None);
        }
        let points = sources.iter().map(|&source| frames(&seen, source));
        let points = points.collect::<Result<Vec<_>>>()?;
        let test = changepoint_test(&points, &candidates, CHANGEPOINT_ORDERS * permutations, rng)?;
        let start = seen[test.changepoint].began;
        let place = summaries.partition_point(|summary| summary.began < start);
        Ok((test.p_value <= self.settings.cut).then_some(place))
    }
}

/// Sorts summaries by the time at which their episodes began.
fn sorted(summaries: &[EpisodeSummary]) -> Vec<&EpisodeSummary> {
    let mut summaries: Vec<&EpisodeSummary> = summaries.iter().collect();
    summaries.sort_by_key(|summary| summary.began);
    summaries
}

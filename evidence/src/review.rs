//! Reviews of policies that an earlier decision proposed, by rollouts that they collected.

use cluster::AssignedPolicy;
use rand::Rng;

use crate::error::Result;
use crate::memory::{all_summaries, check_comparable};
use crate::policy_test::{PolicyRole, PolicyTestResult, TestStage};
use crate::recogniser::{
    Case, Recogniser, RequiredTrial, RolloutDecision, RolloutDecisionContext, SAME_GROUP,
};
use crate::summary::EpisodeSummary;

impl Recogniser {
    /// Reviews the policy `context.collector`, which an earlier decision proposed, by a rollout
    /// that it collected itself; if it fails, decides on another one. Its own motion and returns
    /// are compared, too. After a changepoint only the earlier episodes count, for whose group the
    /// policy was proposed; if the policy fits all episodes but not those, the decision is
    /// `Undecided`, and the episodes are not kept. If images or vectors contradict those for
    /// which it was proposed, the group has changed, and the rollout is judged as by
    /// [`Recogniser::assign_rollout`].
    ///
    /// # Errors
    /// Errors of [`Recogniser::assign_rollout`].
    pub fn review_proposed_policy(
        &mut self,
        summaries: &[EpisodeSummary],
        context: RolloutDecisionContext,
        rng: &mut impl Rng,
    ) -> Result<RolloutDecision> {
        self.check_policy(context.collector)?;
        check_comparable(all_summaries(&self.memories).chain(summaries))?;
        let summaries = self.in_order(summaries)?;
        let is_provisional = context.is_provisional;
        let role = if is_provisional { PolicyRole::Provisional } else { PolicyRole::Returning };
        let mut case = Case::new(&summaries, context);
        let mut decision = self.decide(case, role, rng)?;
        let keep = AssignedPolicy::Existing(context.collector);
        let place = self.find_changepoint(&summaries, rng)?;
        let earlier = Case { summaries: &summaries[..place.unwrap_or(summaries.len())], ..case };
        if decision.policy == keep && self.confirms_proposal(context, &decision.tests) {
            // the policy trains on the part before the changepoint
            let stage = TestStage::Confirmation;
            if place.is_some()
                && context.allow_undecided
                && !self.fits_collector(earlier, role, stage, rng)?
            {
                decision.policy = AssignedPolicy::Undecided;
            }
            decision.group_changed = self.contradicts_proposal(context, &decision.tests);
            decision.is_provisional = is_provisional;
            return Ok(decision);
        }
        if decision.policy != keep
            && let Some(place) = place
        {
            decision = self.decide(earlier, role, rng)?;
            decision.changepoint = Some(summaries[place].began);
            if decision.policy == keep && self.confirms_proposal(context, &decision.tests) {
                decision.is_provisional = is_provisional;
                return Ok(decision);
            }
        }
        if self.contradicts_proposal(context, &decision.tests)
            || self.fits_differing_policy(context, &decision.tests)
        {
            case.summaries = &summaries[place.unwrap_or(0)..];
            let mut anew = self.decide_anew(case, place.is_some(), rng)?;
            // trials could go on for ever in groups that change with every rollout
            if !context.allow_undecided && anew.trial != RequiredTrial::Waived {
                anew.trial = RequiredTrial::None;
            }
            // the acting policy would train on the part before the changepoint
            if place.is_some() && anew.policy == keep && context.allow_undecided {
                anew.policy = AssignedPolicy::Undecided;
            }
            anew.changepoint = place.map(|place| summaries[place].began);
            return Ok(RolloutDecision { group_changed: true, ..anew });
        }
        // no policy is tried twice for one task, or trials might never end
        decision.rejected.push(context.collector);
        self.create_policy(case, decision)
    }

    /// Decides on a rollout whose collector was proposed for another task group. In a short visit
    /// the named policy would act too late, so it trains on the rollout without a trial.
    fn decide_anew(
        &mut self,
        case: Case,
        has_changepoint: bool,
        rng: &mut impl Rng,
    ) -> Result<RolloutDecision> {
        let context = RolloutDecisionContext {
            rejected: &[],
            differing: &[],
            is_provisional: false,
            ..case.context
        };
        let case = Case { context, ..case };
        let decision = self.screen(case, rng)?;
        match decision.policy {
            AssignedPolicy::Existing(named) if named == context.collector => Ok(decision),
            AssignedPolicy::Existing(_)
                if !has_changepoint && decision.trial == RequiredTrial::Rollout =>
            {
                Ok(RolloutDecision { trial: RequiredTrial::Waived, ..decision })
            }
            AssignedPolicy::Existing(_) if !context.allow_undecided => Ok(decision),
            _ => {
                let undecided = RolloutDecision { policy: AssignedPolicy::Undecided, ..decision };
                self.decide_with_kept(case, undecided, rng)
            }
        }
    }

    /// Returns `true` if a rollout that the evidence accepts is of the task group for which the
    /// acting policy was proposed: returns prove it, or images and vectors fit no policy better
    /// that they had rejected then.
    fn confirms_proposal(
        &self,
        context: RolloutDecisionContext,
        tests: &[PolicyTestResult],
    ) -> bool {
        let own = &tests[context.collector];
        own.role == PolicyRole::Provisional
            || self.tester().is_proven(own)
            || !self.fits_differing_policy(context, tests)
    }

    /// Returns `true` if images and vectors of a rollout show another task group than that for which
    /// the acting policy was proposed: they reject it, by more than drift explains if it is
    /// provisional, or fit it although they had rejected it then.
    fn contradicts_proposal(
        &self,
        context: RolloutDecisionContext,
        tests: &[PolicyTestResult],
    ) -> bool {
        let own = &tests[context.collector];
        if own.role == PolicyRole::Provisional {
            let may_be_same = own.first_observation_p_value() >= SAME_GROUP;
            let is_drift = own.first_observation_ratio() <= self.tester().max_isolated_drift();
            return (context.differing.contains(&context.collector) && may_be_same)
                || (own.first_observation_differs(self.settings().level) && !is_drift);
        }
        self.rejects_first_observation(own)
    }

    /// Returns `true` if images or vectors speak against the acting policy, and fit one that they
    /// had rejected when the acting one was proposed.
    fn fits_differing_policy(
        &self,
        context: RolloutDecisionContext,
        tests: &[PolicyTestResult],
    ) -> bool {
        let is_other =
            |&policy: &usize| policy != context.collector && !self.memories[policy].is_merged();
        let mut others = context.differing.iter().copied().filter(is_other);
        let is_doubted =
            |policy: usize| tests[policy].first_observation_p_value() <= self.settings().doubt;
        is_doubted(context.collector) && others.any(|policy| !is_doubted(policy))
    }
}

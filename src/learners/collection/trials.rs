//! Policies that act before they are believed.

use std::time::Instant;

use cluster::Assignment;
use rl::{Experience as _, RolloutState, RolloutStats, VectorEnv, collect};

use crate::error::CoversError;
use crate::groupings::Episodes;

use super::courses::courses;
use super::first_frames::{Rollout, first_frames};
use super::member::Member;
use super::policies::Collection;
use super::settings::{CollectionSettings, Handover, RolloutOf};
use super::training::Training;

/// What a change of hands came to.
pub(super) struct Collected {
    /// The decision that named the policy that stays.
    pub assignment: Assignment,
    /// The rollout of that policy.
    pub stats: RolloutStats,
    /// Decisions of all that acted.
    pub decisions: usize,
    pub created: bool,
}

impl<S: CollectionSettings> Collection<S> {
    /// Whether the policy that was named may learn from a rollout of another one: the paper does
    /// not know rollouts of two groups, nor policies that must act before they are believed.
    pub(super) fn may_reuse(&self) -> bool {
        self.settings.handover() == Handover::Reuse
            && self.grouping.cut().is_none()
            && !self.grouping.is_unproven()
    }

    /// Where the last look showed two groups, leaves the latest `collections` for a replay, which
    /// would take all of them.
    pub(super) fn keep_if_cut(&mut self, collections: usize) {
        if self.grouping.cut().is_some() {
            self.rollout.keep(collections);
        }
    }

    /// Lets the current policy, which `assignment` named, collect a rollout; and other ones where
    /// the grouping reviews what it did and names them. One of several that might be meant is heard
    /// first. What was collected before and shows two groups is learnt by nobody.
    pub(super) fn hand_over(
        &mut self,
        env: &mut dyn VectorEnv,
        mut assignment: Assignment,
        mut created: bool,
    ) -> Result<Collected, CoversError> {
        let mut refused = self.grouping.refused();
        let mut decisions = 0;
        loop {
            self.keep_if_cut(0);
            if !created
                && self.grouping.is_contested()
                && let Some(heard) = self.hear(env, &mut decisions)?
                && let Some(other) = self.review(&heard, &mut refused)?
            {
                created = self.adopt(
                    &other,
                    first_frames(&heard, 0, self.settings.first_frames()),
                )?;
                assignment = other;
                continue;
            }
            let stats = self.roll_out(env)?;
            decisions += stats.decisions;
            let other = match created {
                true => None,
                false => self.review_rollout(&mut refused)?,
            };
            let Some(other) = other else {
                return Ok(Collected {
                    assignment,
                    stats,
                    decisions,
                    created,
                });
            };
            created = self.adopt(&other, self.first_frames(0)?)?;
            assignment = other;
        }
    }

    /// Lets a policy act that may serve the group of the current one, too; if it does, one of the
    /// two goes on for both, with its parameters, its optimiser and its number. Returns the
    /// decisions taken.
    pub(super) fn look_for_twin(&mut self, env: &mut dyn VectorEnv) -> Result<usize, CoversError> {
        let mut decisions = 0;
        let policy = self.current;
        let Some(twin) = self.grouping.twin(policy) else {
            return Ok(0);
        };
        self.current = self.check_policy(twin)?;
        let heard = self.hear(env, &mut decisions)?;
        self.current = policy;
        let Some(heard) = heard else {
            return Ok(decisions);
        };
        let spec = self.spec.clone();
        let seen = |collector, courses| Episodes {
            spec: &spec,
            collector,
            courses,
        };
        let heard = courses(&heard, 0);
        let rng = &mut self.generators.assignment;
        if self
            .grouping
            .compare(policy, twin, seen(twin, &heard), rng)?
            && let Some(again) = self.hear(env, &mut decisions)?
        {
            let again = courses(&again, 0);
            let both = [seen(twin, &heard), seen(policy, &again)];
            let rng = &mut self.generators.assignment;
            let merge = self.grouping.merge(policy, twin, both, rng)?;
            self.current = merge.map_or(policy, |merge| merge.kept);
        }
        Ok(decisions)
    }

    /// Lets the current policy act for [`Collection::hearing`] steps, and adds the decisions to
    /// those taken.
    fn hear(
        &mut self,
        env: &mut dyn VectorEnv,
        decisions: &mut usize,
    ) -> Result<Option<RolloutOf<S>>, CoversError> {
        let Some(steps) = self.hearing(env) else {
            return Ok(None);
        };
        let clock = Instant::now();
        let mut heard = self.settings.rollout(env.spec(), steps)?;
        let Member {
            policy, training, ..
        } = &mut self.members[self.current];
        training.prepare(&mut heard);
        let mut state = RolloutState::reset(env, policy)?;
        let rng = &mut self.generators.actions;
        *decisions += collect(env, policy, &mut heard, &mut state, rng)?.decisions;
        self.seconds.collection += clock.elapsed().as_secs_f64();
        Ok(Some(heard))
    }

    /// Steps in which the environments show as many episodes as the grouping needs, at least one
    /// each. None where that takes no less than a rollout, or nobody knows how long.
    fn hearing(&self, env: &dyn VectorEnv) -> Option<usize> {
        let episodes = self.grouping.min_episodes().div_ceil(self.spec.num_envs);
        let steps = env.horizon()?.checked_mul(episodes.max(1))?;
        (steps < self.rollout.steps()).then_some(steps)
    }

    /// Asks the grouping whether the current policy, which has acted since it was named, is the
    /// right one; the answer is another one, or nothing.
    fn review(
        &mut self,
        rollout: &RolloutOf<S>,
        refused: &mut Vec<usize>,
    ) -> Result<Option<Assignment>, CoversError> {
        let frames = first_frames(rollout, 0, self.settings.first_frames());
        let courses = courses(rollout, 0);
        self.ask(&frames, &courses, |grouping, clouds, rng| {
            grouping.review(clouds, refused, rng)
        })
    }

    /// The same by the rollout that was collected last.
    fn review_rollout(
        &mut self,
        refused: &mut Vec<usize>,
    ) -> Result<Option<Assignment>, CoversError> {
        let (frames, courses) = (self.first_frames(0)?, courses(&self.rollout, 0));
        self.ask(&frames, &courses, |grouping, clouds, rng| {
            grouping.review(clouds, refused, rng)
        })
    }
}

//! Steps of the learner that the paper's Algorithm 1 does not have: the choice of the policy that
//! collects, undecided rollouts, trials of policies before they train, rollouts of two groups, and
//! merges of policies.

use cluster::AssignedPolicy;
use evidence::{PreviousParameters, RequiredTrial, Trajectory};
use rl::{Actor as _, ExperienceBuffer as _, RlError, RolloutState, VectorEnv};
use web_time::Instant;

use crate::error::LearnerError;
use crate::groupings::{
    AssignmentPurpose, EpisodeRequirements, GroupingDecision, GroupingUpdateInput,
    GroupingUpdateResult, RolloutEpisodes,
};
use crate::learners::learner::{IterationReport, IterationSeconds};

use super::PolicyCollection;
use super::episodes::{ObservedEpisodes, Rollout};
use super::settings::{
    PolicyCollectionSettings, PolicyTrainer, ReassignedRolloutHandling, RolloutInCollection,
    RolloutStateInCollection,
};

impl<S: PolicyCollectionSettings> PolicyCollection<S> {
    /// Resets the environments, and makes the policy current that should act in the episodes that
    /// begin, if the grouping chooses one. Returns the beginnings of the episodes.
    pub(super) fn choose_collector(
        &mut self,
        env: &mut dyn VectorEnv,
        seconds: &mut IterationSeconds,
    ) -> Result<RolloutStateInCollection<S>, LearnerError> {
        let mut state = self.begin_episodes(env, seconds)?;
        let EpisodeRequirements { episodes, chooses_collector, .. } = self.grouping.requirements();
        let has_choice = self.policies.len() > 1 && self.spec.num_envs >= episodes;
        // other environments are refused where the rollout is collected
        if !chooses_collector || !has_choice || *env.spec() != self.spec {
            return Ok(state);
        }
        let beginnings = (0..self.spec.num_envs).map(|n| {
            let (image, vector) = state.observations.image_and_vector(&self.spec, n);
            let (image, vectors) = (image.to_vec(), vector.to_vec());
            Trajectory { image, vectors, ..Trajectory::default() }
        });
        let observed = ObservedEpisodes { frames: Vec::new(), trajectories: beginnings.collect() };
        let decision = self.assign(AssignmentPurpose::Collect, &observed, seconds)?;
        if let AssignedPolicy::Existing(chosen) = decision.policy {
            self.current = self.check_policy(chosen)?;
            state.memory = self.policies[chosen].policy.new_memory(self.spec.num_envs);
        }
        Ok(state)
    }

    /// Collects a rollout with the current policy. If it is `doubted`, it acts with its parameters
    /// from before its latest update, and the rollout is prepared for training the latest ones.
    /// Returns the availability of the earlier parameters.
    pub(super) fn roll_out_after_doubt(
        &mut self,
        env: &mut dyn VectorEnv,
        state: RolloutStateInCollection<S>,
        doubted: Option<usize>,
        iteration: &mut IterationReport,
    ) -> Result<PreviousParameters, LearnerError> {
        let has_previous = self.policies[self.current].previous.is_some();
        if !has_previous || doubted != Some(self.current) {
            self.roll_out(env, state, iteration)?;
            return Ok(if has_previous {
                PreviousParameters::Available
            } else {
                PreviousParameters::Unavailable
            });
        }
        self.policies[self.current].swap_previous();
        let rolled_out = self.roll_out(env, state, iteration);
        self.policies[self.current].swap_previous();
        rolled_out?;
        self.adapt_rollout()?;
        Ok(PreviousParameters::Acted)
    }

    /// Resets the environments; returns the beginnings of their episodes, in which the current
    /// policy is to act.
    fn begin_episodes(
        &self,
        env: &mut dyn VectorEnv,
        seconds: &mut IterationSeconds,
    ) -> Result<RolloutStateInCollection<S>, RlError> {
        let clock = Instant::now();
        let state = RolloutState::from_env_reset(env, &self.policies[self.current].policy)?;
        seconds.collection += clock.elapsed().as_secs_f64();
        Ok(state)
    }

    /// Discards the stored rollouts, which the grouping left undecided, and counts one in
    /// `iteration`.
    pub(super) fn discard(&mut self, iteration: &mut IterationReport) {
        self.rollout.keep_latest(0);
        iteration.discarded += 1;
    }

    /// Prepares the rollout of `collector` for training the current policy, which `decision` named,
    /// or lets this policy collect a new one, since a rollout of another policy is off-policy.
    /// Returns the policy that collected the rollout; `None` if no policy may train on it.
    ///
    /// If the decision demands a trial, the grouping judges each new rollout and may name other
    /// policies, which then collect their own.
    pub(super) fn prepare_training_rollout(
        &mut self,
        env: &mut dyn VectorEnv,
        collector: usize,
        decision: &mut GroupingDecision,
        iteration: &mut IterationReport,
    ) -> Result<Option<usize>, LearnerError> {
        if self.current == collector {
            return Ok(Some(collector));
        }
        if self.may_reuse(decision) {
            self.adapt_rollout()?;
            return Ok(Some(collector));
        }
        // ends because a grouping names no rejected policy again in one group, groups that change
        // count as discarded rollouts, and no trial is needed once too many were discarded
        loop {
            // all collections so far are of other policies, and a replay would take those of
            // another group, too
            if decision.changepoint.is_some() || decision.group_changed {
                self.rollout.keep_latest(0);
            }
            if let Some(actor) = self.try_current_policy(env, decision, iteration)? {
                return Ok(Some(actor));
            }
            if decision.policy == AssignedPolicy::Undecided {
                return Ok(None);
            }
            if decision.group_changed {
                iteration.discarded += 1;
            }
        }
    }

    /// Lets the current policy, which `decision` named, collect a rollout, and first a few episodes
    /// if the decision demands that. Returns the policy that collected the rollout if the current
    /// policy may train on it; otherwise `decision` is the grouping's next one.
    fn try_current_policy(
        &mut self,
        env: &mut dyn VectorEnv,
        decision: &mut GroupingDecision,
        iteration: &mut IterationReport,
    ) -> Result<Option<usize>, LearnerError> {
        if decision.trial == RequiredTrial::Episodes
            && !iteration.policy_created
            && iteration.may_discard()
            && let Some(probe) = self.probe(env, iteration)?
        {
            if !self.passes_trial(self.observed_episodes_in(&probe), decision, iteration)? {
                return Ok(None);
            }
            if decision.group_changed {
                self.rollout.keep_latest(0);
            }
        }
        let actor = self.current;
        let state = self.begin_episodes(env, &mut iteration.seconds)?;
        self.roll_out(env, state, iteration)?;
        let may_end = iteration.policy_created || decision.group_changed;
        let is_final =
            decision.trial == RequiredTrial::None || (may_end && !iteration.may_discard());
        let is_confirmed =
            is_final || self.passes_trial(self.observe_rollout()?, decision, iteration)?;
        let is_waived = !is_confirmed && decision.trial == RequiredTrial::Waived;
        if !is_confirmed && !is_waived {
            return Ok(None);
        }
        if decision.group_changed {
            // earlier collections are of another group
            self.rollout.keep_latest(1);
        }
        if is_waived {
            self.adapt_rollout()?;
        }
        Ok(Some(actor))
    }

    /// Returns `true` if the policy that `decision` names may train on a rollout of another policy.
    /// A rollout of two groups is discarded, and a provisional policy must act before it trains.
    fn may_reuse(&self, decision: &GroupingDecision) -> bool {
        self.settings.common().handover == ReassignedRolloutHandling::Reuse
            && decision.changepoint.is_none()
            && !decision.is_provisional
    }

    /// Prepares the stored rollout, which another policy collected, for training the current
    /// policy.
    fn adapt_rollout(&mut self) -> Result<(), LearnerError> {
        let policy = &mut self.policies[self.current].policy;
        Ok(S::Trainer::adapt_rollout(policy, &mut self.rollout)?)
    }

    /// Asks the grouping to confirm the current policy, which `decision` named, from episodes that
    /// it collected. If the answer differs, `decision` becomes the answer, and the policy that it
    /// names becomes current.
    fn passes_trial(
        &mut self,
        observed: ObservedEpisodes,
        decision: &mut GroupingDecision,
        iteration: &mut IterationReport,
    ) -> Result<bool, LearnerError> {
        let allow_undecided = iteration.may_discard();
        let request = AssignmentPurpose::Confirm { proposal: decision, allow_undecided };
        let judged = self.assign(request, &observed, &mut iteration.seconds)?;
        let passes = judged.policy == AssignedPolicy::Existing(self.current);
        if passes {
            if judged.group_changed {
                *decision = judged;
            } else {
                decision.accepted = judged.accepted;
            }
            return Ok(true);
        }
        if judged.policy != AssignedPolicy::Undecided {
            // a policy that exists needs no frames of two groups
            let is_mixed = judged.changepoint.is_some() && judged.policy != AssignedPolicy::New;
            let frames = if is_mixed { Vec::new() } else { observed.frames };
            iteration.policy_created = self.make_current(&judged, frames)?;
        }
        *decision = judged;
        Ok(false)
    }

    /// Collects as many episodes of the current policy as the grouping needs, at least one in each
    /// environment. Returns `None` if that takes at least as many steps as a rollout, or if the
    /// horizon is unknown.
    fn probe(
        &mut self,
        env: &mut dyn VectorEnv,
        iteration: &mut IterationReport,
    ) -> Result<Option<RolloutInCollection<S>>, LearnerError> {
        let episodes = self.grouping.requirements().episodes.div_ceil(self.spec.num_envs);
        let steps = env
            .horizon()
            .and_then(|horizon| horizon.checked_mul(episodes.max(1)))
            .filter(|&steps| steps < self.rollout.steps_per_env());
        let Some(steps) = steps else {
            return Ok(None);
        };
        let mut rollout = self.settings.new_rollout(env.spec(), steps)?;
        let state = self.begin_episodes(env, &mut iteration.seconds)?;
        let rng = &mut self.generators.actions;
        self.policies[self.current].act(env, state, &mut rollout, rng, iteration)?;
        Ok(Some(rollout))
    }

    /// Updates the grouping with the rollout of `collector`, which the current policy is about to
    /// train on, and drops the rollout's steps after a changepoint.
    pub(super) fn update_grouping(
        &mut self,
        collector: usize,
        decision: &GroupingDecision,
        seconds: &mut IterationSeconds,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        let clock = Instant::now();
        let trajectories = self.trajectories_in(&self.rollout);
        let assigned = GroupingUpdateInput::Rollout {
            policy: self.current,
            accepted: &decision.accepted,
            episodes: RolloutEpisodes { spec: &self.spec, collector, trajectories: &trajectories },
        };
        let rng = &mut self.generators.assignment;
        let update = self.grouping.update(assigned, rng)?;
        if let Some(changepoint) = update.changepoint {
            self.rollout.truncate(changepoint / self.spec.num_envs)?;
        }
        seconds.assignment += clock.elapsed().as_secs_f64();
        Ok(update)
    }

    /// Collects episodes of policies that may serve the same task group as the current one, until
    /// the grouping has decided on a merge. One of the two continues for both, with its parameters,
    /// optimiser and index.
    pub(super) fn merge_duplicates(
        &mut self,
        env: &mut dyn VectorEnv,
        mut update: GroupingUpdateResult,
        iteration: &mut IterationReport,
    ) -> Result<(), LearnerError> {
        let policy = self.current;
        let mut acted: Vec<(usize, Vec<Trajectory>)> = Vec::new();
        while let Some(next) = update.probe {
            self.current = self.check_policy(next)?;
            let Some(probe) = self.probe(env, iteration)? else {
                break;
            };
            acted.push((next, self.trajectories_in(&probe)));
            let probes = acted.iter().map(|(collector, trajectories)| RolloutEpisodes {
                spec: &self.spec,
                collector: *collector,
                trajectories,
            });
            let probes: Vec<RolloutEpisodes<'_>> = probes.collect();
            let rng = &mut self.generators.assignment;
            let assigned = GroupingUpdateInput::Probes { policy, probes: &probes };
            update = self.grouping.update(assigned, rng)?;
        }
        let merged_into = update.merged_into.get(policy).copied().flatten();
        self.current = merged_into.unwrap_or(policy);
        iteration.merged_into = update.merged_into;
        Ok(())
    }
}

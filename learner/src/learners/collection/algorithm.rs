//! Algorithm 1 of the paper: collect, assign, update. Read this file from top to bottom.
//!
//! Liu, Xu, Huang, Zhang, Liu, Oguchi, Zhao, "Continual Vision-based Reinforcement Learning with
//! Group Symmetries", CoRL 2023. Where the paper leaves a gap, the setting that closes it says so.
//! Steps that the paper does not have are in `extensions.rs`; comments `Extension` in `learn` mark
//! where they take place.
//!
//! A run calls [`Learner::learn`] once per iteration (`experiments/src/run.rs`); the environment
//! changes the task group by itself. The assignment of lines 8 to 10 is a [`crate::Grouping`]: by
//! default (`groupings/evidence.rs`) W1 of images, motion and returns, with a permutation test in
//! the place of the paper's threshold; it is undecided if one rollout is too little.
//! `recognise_policy` and `evaluate_policy` serve evaluations; the second `impl` has the steps of
//! `learn`.

use std::path::Path;

use cluster::AssignedPolicy;
use evidence::{RequiredTrial, Trajectory};
use rand_chacha::ChaCha8Rng;
use rl::{
    ExperienceBuffer, ExportPolicy, ExportedPolicy, MeasureUnitActivity, Observations,
    PolicyOutput, RlError, RolloutState, UnitActivity, VectorEnv, collect_experience,
};
use web_time::Instant;

use crate::error::LearnerError;
use crate::groupings::{AssignmentPurpose, GroupingDecision, RecognisedPolicy};
use crate::learners::learner::{
    CheckpointExtent, IterationReport, IterationSeconds, Learner, PolicyEvaluationResult,
};

use super::episodes::{FirstFrames, ObservedEpisodes, first_frames, trajectories};
use super::settings::{
    NewPolicyInit, PolicyCollectionSettings, PolicyTrainer, RolloutInCollection,
    RolloutStateInCollection,
};
use super::{CandidateClouds, PolicyCollection, PolicyEntry, no_nearest_policy};

/// Number of decisions between two measurements of the activity of a network's units, in an
/// evaluation.
// One measurement costs about as much as a decision with its picture.
const ACTIVITY_INTERVAL: usize = 10;

impl<S: PolicyCollectionSettings> Learner for PolicyCollection<S> {
    /// Runs lines 4 to 14 of Algorithm 1 until a rollout may train a policy, then lines 15 and 16.
    /// Lines 2, 3 and 18 count the steps up to the next assignment: here every rollout is assigned,
    /// since `N_u` and `N_s` are equal.
    fn learn(&mut self, env: &mut dyn VectorEnv) -> Result<IterationReport, LearnerError> {
        let (mut iteration, policies) = (IterationReport::default(), self.policies.len());
        let mut doubted = None;
        let (actor, decision) = loop {
            // Lines 4 to 7: roll out N_s steps with the current policy into D (`self.rollout`); O
            // (`observed`) takes the first k frames of each episode.
            // Extension: another policy collects it if the first observations are of its group.
            let state = self.choose_collector(env, &mut iteration.seconds)?;
            // After a doubt that its latest update may explain, it acts as before that update.
            let collector = self.current;
            let previous_parameters =
                self.roll_out_after_doubt(env, state, doubted.take(), &mut iteration)?;
            let mut observed = self.observe_rollout()?;

            // Lines 8 to 10: the distances of O from every B_i, the nearest policy, the threshold.
            // Extension: a single rollout may be too little to decide, and trains no policy then.
            let allow_undecided = iteration.may_discard();
            let request = AssignmentPurpose::Assign { allow_undecided, previous_parameters };
            let mut decision = self.assign(request, &observed, &mut iteration.seconds)?;
            if decision.policy == AssignedPolicy::Undecided {
                let is_retry = decision.trial == RequiredTrial::PreviousParameters;
                doubted = is_retry.then_some(collector);
                self.discard(&mut iteration);
                continue;
            }
            // Extension: if the group changed within the rollout, only the later episodes count.
            observed.drop_frames_before_changepoint(decision.changepoint);

            // Lines 11 and 12: a new random policy with B = O; lines 13 and 14: the nearest policy,
            // whose B takes O. Extension: D of another policy is off-policy, so the one that was
            // assigned may have to collect it anew (`actor` is the policy that collected D in the
            // end), or D is discarded if that shows another group.
            iteration.policy_created = self.make_current(&decision, observed.frames)?;
            if let Some(actor) =
                self.prepare_training_rollout(env, collector, &mut decision, &mut iteration)?
            {
                break (actor, decision);
            }
            self.discard(&mut iteration);
        };
        // Extension: a grouping that remembers whole episodes is updated, too.
        let memory_update = self.update_grouping(actor, &decision, &mut iteration.seconds)?;

        // Lines 15 and 16: update the current policy with D: by `Sac::update` (rl/src/sac.rs) from
        // the policy's replay, to which D is added, or by `Ppo::update` (rl/src/ppo.rs).
        // Extension: policies that turn out to serve one group are merged.
        let update = self.update(&mut iteration.seconds)?;
        iteration.policy = self.current;
        iteration.policy_created = self.current >= policies;
        self.merge_duplicates(env, memory_update, &mut iteration)?;

        iteration.evidence = decision.evidence;
        iteration.log_metrics(update);
        Ok(iteration)
    }

    /// Collects the first frames of the requested number of episodes, or of as many as the grouping
    /// needs, at least one in each environment.
    fn recognise_policy(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<RecognisedPolicy, LearnerError> {
        let observed = self.collect_for_recognition(env, episodes, rng)?;
        if !self.has_trained() {
            return Ok(RecognisedPolicy { policy: 0, fits: true });
        }
        let mut candidates =
            CandidateClouds::new(&mut self.policies, self.current, &self.spec, &observed);
        let decision = self.grouping.assign(AssignmentPurpose::Recognise, &mut candidates, rng)?;
        let recognised = RecognisedPolicy::from(&decision);
        self.check_policy(recognised.policy)?;
        Ok(recognised)
    }

    fn evaluate_policy(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<PolicyEvaluationResult, LearnerError> {
        let index = self.check_policy(index)?;
        let mut activity = UnitActivity::default();
        let policy = &mut self.policies[index].policy;
        let stats = rl::evaluate_policy_with_callback(env, policy, rounds, |policy, state| {
            let steps = state.episodes.first().map_or(0, |episode| episode.length);
            if steps.is_multiple_of(ACTIVITY_INTERVAL) {
                activity.add(&policy.unit_activity(&state.observations, &state.memory)?);
            }
            Ok(())
        })?;
        Ok(PolicyEvaluationResult { stats, activity })
    }

    fn export_policy(&self, index: usize) -> Result<ExportedPolicy, LearnerError> {
        let index = self.check_policy(index)?;
        Ok(self.policies[index].policy.export()?)
    }

    fn policy_output(
        &mut self,
        index: usize,
        observations: &Observations,
    ) -> Result<PolicyOutput, LearnerError> {
        let index = self.check_policy(index)?;
        Ok(self.policies[index].policy.reference_output(observations)?)
    }

    fn policy_parameters(&self, index: usize) -> Option<&[f32]> {
        let entry = self.policies.get(index)?;
        Some(S::params(&entry.policy))
    }

    fn policy_count(&self) -> usize {
        self.policies.len()
    }

    fn to_checkpoint_bytes(
        &self,
        path: &Path,
        extent: CheckpointExtent,
        note: &str,
    ) -> Result<Vec<u8>, LearnerError> {
        self.to_bytes(path, extent, note)
    }
}

impl<S: PolicyCollectionSettings> PolicyCollection<S> {
    /// Collects a rollout of `N_s` decisions with the current policy (line 5 of Algorithm 1), from
    /// the beginnings of its episodes.
    pub(super) fn roll_out(
        &mut self,
        env: &mut dyn VectorEnv,
        state: RolloutStateInCollection<S>,
        iteration: &mut IterationReport,
    ) -> Result<(), LearnerError> {
        self.check_horizon(env)?;
        let entry = &mut self.policies[self.current];
        let (rollout, rng) = (&mut self.rollout, &mut self.generators.actions);
        iteration.rollout_stats = entry.act(env, state, rollout, rng, iteration)?;
        Ok(())
    }

    /// Rejects rollouts shorter than an episode, which would never reach its late states.
    fn check_horizon(&self, env: &dyn VectorEnv) -> Result<(), RlError> {
        let steps = self.rollout.steps_per_env();
        match env.horizon() {
            Some(horizon) if steps < horizon => Err(RlError::ShortRollout { steps, horizon }),
            Some(_) | None => Ok(()),
        }
    }

    /// Returns the first frames of the collected rollout's episodes (line 6 of Algorithm 1), and
    /// their trajectories if the grouping needs them; rejects a rollout with too few.
    pub(super) fn observe_rollout(&self) -> Result<ObservedEpisodes, LearnerError> {
        let observed = self.observed_episodes_in(&self.rollout);
        self.check_episodes(observed.frames.len())?;
        Ok(observed)
    }

    /// Returns the first frames of a rollout's episodes, and their trajectories if the grouping
    /// needs them.
    pub(super) fn observed_episodes_in(
        &self,
        rollout: &RolloutInCollection<S>,
    ) -> ObservedEpisodes {
        ObservedEpisodes {
            frames: first_frames(rollout, self.settings.common().first_frames),
            trajectories: self.trajectories_in(rollout),
        }
    }

    /// Returns the trajectories of a rollout's episodes, unfinished ones included, if the grouping
    /// needs them, else none.
    pub(super) fn trajectories_in(&self, rollout: &RolloutInCollection<S>) -> Vec<Trajectory> {
        if self.grouping.requirements().whole_episodes { trajectories(rollout) } else { Vec::new() }
    }

    /// Rejects a rollout with too few first frames to be assigned.
    fn check_episodes(&self, got: usize) -> Result<(), LearnerError> {
        let needed = self.grouping.requirements().episodes;
        if got >= needed {
            return Ok(());
        }
        Err(LearnerError::TooFewEpisodes {
            got,
            needed,
            first_frames: self.settings.common().first_frames,
        })
    }

    /// Asks the grouping which policy a rollout belongs to (lines 8 to 10 of Algorithm 1); the very
    /// first rollout belongs to policy 0.
    pub(super) fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        observed: &ObservedEpisodes,
        seconds: &mut IterationSeconds,
    ) -> Result<GroupingDecision, LearnerError> {
        // the paper starts with an empty `B`, for which no distance exists
        if !self.has_trained() {
            return Ok(GroupingDecision::for_policy(AssignedPolicy::Existing(0)));
        }
        let clock = Instant::now();
        let mut candidates =
            CandidateClouds::new(&mut self.policies, self.current, &self.spec, observed);
        let rng = &mut self.generators.assignment;
        let decision = self.grouping.assign(request, &mut candidates, rng)?;
        seconds.assignment += clock.elapsed().as_secs_f64();
        Ok(decision)
    }

    /// Returns `true` if a rollout was assigned to policy 0, the first one of all.
    fn has_trained(&self) -> bool {
        self.policies[0].buffer.num_offered() > 0
    }

    /// Makes the assigned policy the one that acts, creates it if it is new, and adds `frames` to
    /// its buffer (lines 11 to 14 of Algorithm 1); returns `true` if it is new.
    pub(super) fn make_current(
        &mut self,
        decision: &GroupingDecision,
        frames: Vec<FirstFrames>,
    ) -> Result<bool, LearnerError> {
        let policies = self.policies.len();
        self.current = match decision.policy {
            AssignedPolicy::Existing(index) => self.check_policy(index)?,
            AssignedPolicy::New | AssignedPolicy::Undecided => {
                let parent = self.parent(decision)?;
                self.create_policy(parent)?
            }
        };
        let buffer = &mut self.policies[self.current].buffer;
        for episode in frames {
            buffer.offer(episode, &mut self.generators.assignment);
        }
        Ok(self.current == policies)
    }

    /// Returns the index of the policy whose parameters a new policy copies; `None` for random
    /// ones.
    fn parent(&self, decision: &GroupingDecision) -> Result<Option<usize>, LearnerError> {
        match (self.settings.common().new_policy, decision.nearest) {
            (NewPolicyInit::Random, _) => Ok(None),
            (NewPolicyInit::Copy, Some(nearest)) => Ok(Some(nearest)),
            (NewPolicyInit::Copy, None) => Err(no_nearest_policy()),
        }
    }

    /// Trains the current policy on the rollout (line 15); returns the values to log.
    fn update(
        &mut self,
        seconds: &mut IterationSeconds,
    ) -> Result<Vec<(String, f64)>, LearnerError> {
        let clock = Instant::now();
        let PolicyEntry { policy, training, previous, .. } = &mut self.policies[self.current];
        let rng = &mut self.generators.updates;
        *previous = Some(policy.clone());
        let logged = training.learn(policy, &mut self.rollout, rng)?;
        seconds.update += clock.elapsed().as_secs_f64();
        Ok(logged)
    }

    /// Collects new episodes that are not used for training: exactly `episodes`, or for `None` at
    /// least as many as the grouping needs.
    fn collect_for_recognition(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<ObservedEpisodes, LearnerError> {
        let steps = self.settings.common().first_frames;
        let mut rollout = self.settings.new_rollout(env.spec(), steps)?;
        let mut observed = ObservedEpisodes::default();
        while observed.frames.len() < episodes.unwrap_or(self.grouping.requirements().episodes) {
            let policy = &mut self.policies[self.current].policy;
            let mut state = RolloutState::from_env_reset(env, policy)?;
            collect_experience(env, policy, &mut rollout, &mut state, rng)?;
            let seen = self.observed_episodes_in(&rollout);
            // no episode is long enough: without this error the loop would never end
            if seen.frames.is_empty() {
                self.check_episodes(0)?;
            }
            observed.extend(seen);
        }
        if let Some(episodes) = episodes {
            observed.frames.truncate(episodes);
            observed.trajectories.truncate(episodes);
        }
        Ok(observed)
    }
}

//! Grouping by images, motion and returns of whole episodes, instead of features that a policy has
//! learnt.

use cluster::{AssignedPolicy, PolicyAssignment};
use evidence::{
    EpisodeSummariser, EpisodeSummary, ImageFeatureCache, PolicyTestResult, Recogniser,
    RecogniserSettings, RolloutDecision, RolloutDecisionContext,
};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::error::LearnerError;

use super::grouping::{
    AssignmentData, AssignmentPurpose, EpisodeRequirements, Grouping, GroupingDecision,
    GroupingUpdateInput, GroupingUpdateResult, RolloutEpisodes,
};
use super::threshold::nearest_policy;

/// Grouping that compares summaries of episodes with those that each policy trained on
/// ([`evidence::Recogniser`]). A policy that replaces another one must pass a trial.
#[derive(Debug)]
pub struct EvidenceGrouping {
    recogniser: Recogniser,
    /// Cache of image features: a decision and the call of [`Grouping::update`] after it use the
    /// same images.
    cache: ImageFeatureCache,
}

impl EvidenceGrouping {
    /// Creates a grouping that knows no policies yet.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, LearnerError> {
        Ok(Self { recogniser: Recogniser::new(settings)?, cache: ImageFeatureCache::default() })
    }

    /// Returns the summaries of episodes, without motion and returns if a policy other than
    /// `policy` collected them, since those depend on the policy that acts.
    fn summarise(
        &mut self,
        episodes: RolloutEpisodes<'_>,
        policy: usize,
    ) -> Result<Vec<EpisodeSummary>, LearnerError> {
        let RolloutEpisodes { spec, collector, trajectories } = episodes;
        let filters = self.recogniser.settings().filters;
        let (vector, action) = (&spec.vector_irreps, &spec.action_irreps);
        let summariser = EpisodeSummariser::new(spec.image_shape, vector, action, filters)?;
        let mut summaries = summariser.summarise(trajectories, &mut self.cache)?;
        if policy != collector {
            summaries.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        }
        Ok(summaries)
    }

    /// Returns the most probable policy for episodes that are not used for training. Episodes that
    /// are unusual for all policies, as images of another camera, are compared in the policies' own
    /// features instead, which depend less on traces of in-painting.
    fn recognise(
        &self,
        summaries: &[EpisodeSummary],
        data: &mut dyn AssignmentData,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let found = self.recogniser.task_group_probabilities(summaries, rng)?;
        let best = match found.most_probable_policy().filter(|_| found.fits_any_policy()) {
            Some(policy) => policy,
            None => {
                let merged = self.recogniser.merged_into().into_iter().enumerate();
                let left = merged.filter(|(_, other)| other.is_none()).map(|(policy, _)| policy);
                nearest_policy(data, left)?
            }
        };
        let fits = found.policies.get(best).is_some_and(|&p| p >= found.none);
        let policy = if fits { AssignedPolicy::Existing(best) } else { AssignedPolicy::Undecided };
        Ok(GroupingDecision { nearest: Some(best), ..GroupingDecision::for_policy(policy) })
    }
}

impl From<RolloutDecision> for GroupingDecision {
    fn from(decision: RolloutDecision) -> Self {
        let accepted = match decision.policy {
            AssignedPolicy::Existing(_) => decision.accepted_policies(),
            AssignedPolicy::New | AssignedPolicy::Undecided => Vec::new(),
        };
        let evidence = decision.tests.iter().map(PolicyTestResult::evidence).collect();
        Self {
            changepoint: decision.changepoint,
            group_changed: decision.group_changed,
            trial: decision.trial,
            is_provisional: decision.is_provisional,
            rejected: decision.rejected,
            differing: decision.differing,
            accepted,
            ..PolicyAssignment { decision: decision.policy, evidence }.into()
        }
    }
}

impl Grouping for EvidenceGrouping {
    fn requirements(&self) -> EpisodeRequirements {
        let episodes = self.recogniser.settings().min_episodes;
        EpisodeRequirements { episodes, whole_episodes: true, chooses_collector: true }
    }

    fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let collector = data.episodes().collector;
        let summaries = self.summarise(data.episodes(), collector)?;
        let context = RolloutDecisionContext::for_collector(collector);
        let decision = match request {
            AssignmentPurpose::Recognise => return self.recognise(&summaries, data, rng),
            AssignmentPurpose::Collect => {
                let chosen = self.recogniser.choose_collector(&summaries, collector, rng)?;
                return Ok(GroupingDecision::for_policy(AssignedPolicy::Existing(chosen)));
            }
            AssignmentPurpose::Assign { allow_undecided, previous_parameters } => {
                let context =
                    RolloutDecisionContext { allow_undecided, previous_parameters, ..context };
                self.recogniser.assign_rollout(&summaries, context, rng)?
            }
            AssignmentPurpose::Confirm { proposal, allow_undecided } => {
                let context = RolloutDecisionContext {
                    rejected: &proposal.rejected,
                    differing: &proposal.differing,
                    is_provisional: proposal.is_provisional,
                    allow_undecided,
                    ..context
                };
                self.recogniser.review_proposed_policy(&summaries, context, rng)?
            }
        };
        Ok(decision.into())
    }

    /// Remembers a rollout, or merges two policies. Before a merge both act in the task group of
    /// `policy`: first the other policy, and if it serves the group, `policy` again.
    fn update(
        &mut self,
        assigned: GroupingUpdateInput<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        let (mut changepoint, mut probe) = (None, None);
        match assigned {
            GroupingUpdateInput::Rollout { policy, accepted, episodes } => {
                let summaries = self.summarise(episodes, policy)?;
                changepoint = self.recogniser.record_training(policy, &summaries, rng)?;
                probe = self.recogniser.find_possible_duplicate(policy, accepted);
            }
            GroupingUpdateInput::Probes { policy, probes: &[first] } => {
                let duplicate = first.collector;
                let summaries = self.summarise(first, duplicate)?;
                let serves =
                    self.recogniser.confirm_duplicate(policy, duplicate, &summaries, rng)?;
                probe = serves.then_some(policy);
            }
            GroupingUpdateInput::Probes { policy, probes: &[first, again, ..] } => {
                let duplicate = first.collector;
                let of_duplicate = self.summarise(first, duplicate)?;
                let again = self.summarise(again, policy)?;
                self.recogniser.recheck_and_merge(policy, duplicate, &of_duplicate, &again, rng)?;
            }
            GroupingUpdateInput::Probes { probes: &[], .. } => {}
        }
        Ok(GroupingUpdateResult { changepoint, probe, merged_into: self.recogniser.merged_into() })
    }

    fn state(&self) -> Value {
        // numbers always serialise; if they did not, `restore` would reject this text and print it
        let state = self.recogniser.serialise_state(serde_json::value::Serializer);
        state.unwrap_or_else(|error| Value::String(format!("no episodes were saved: {error}")))
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let mut restored = self.recogniser.clone();
        restored.restore_state(state).map_err(|error| error.to_string())?;
        let known = restored.policy_count();
        // a fresh learner has one policy, which has not trained yet
        if known != policies && (known, policies) != (0, 1) {
            return Err(format!("episodes of {known} policies, expected {policies}"));
        }
        self.recogniser = restored;
        Ok(())
    }
}

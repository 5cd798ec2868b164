//! Trait of all groupings, with their requests and decisions.

use cluster::{
    AssignedPolicy, NearerPolicyInputs, PolicyAssignment, PolicyEvidence, RolloutAndBufferFeatures,
};
use evidence::{PreviousParameters, RequiredTrial, Trajectory};
use rand_chacha::ChaCha8Rng;
use rl::EnvSpec;
use serde_json::Value;

use crate::error::LearnerError;

/// Rule that assigns rollouts to policies (lines 8 to 14 of the paper's Algorithm 1).
///
/// Policy 0 exists from the start and takes the very first rollout without a decision.
pub trait Grouping: Send {
    /// Returns the number and the kind of the episodes that an assignment needs: by default the
    /// first frames of one episode.
    fn requirements(&self) -> EpisodeRequirements {
        EpisodeRequirements { episodes: 1, whole_episodes: false, chooses_collector: false }
    }

    /// Decides which policy the rollout in `data` belongs to: an existing one, a new one, or none
    /// yet. After [`AssignedPolicy::New`] a policy is created, unless the request is
    /// [`AssignmentPurpose::Recognise`].
    ///
    /// # Errors
    /// Frames or episodes that cannot be compared.
    fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError>;

    /// Updates the grouping's memory with episodes that were assigned to a policy. The default
    /// remembers nothing.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn update(
        &mut self,
        _: GroupingUpdateInput<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        Ok(GroupingUpdateResult::default())
    }

    /// Returns the state of the grouping for a checkpoint, as JSON. The default has none.
    fn state(&self) -> Value {
        Value::Null
    }

    /// Restores the state that [`Grouping::state`] returned, for a learner with `policies`
    /// policies.
    ///
    /// # Errors
    /// A description of the problem.
    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        match state {
            Value::Null => Ok(()),
            other => Err(format!("got {other} of {policies} policies, expected none")),
        }
    }
}

/// Requirements of a grouping: number and kind of the episodes that an assignment needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeRequirements {
    /// Number of episodes that a rollout must contain, and that must be kept for each policy, at
    /// least 1.
    pub episodes: usize,
    /// `true` if the grouping uses whole episodes and not only their first frames; otherwise
    /// [`RolloutEpisodes::trajectories`] is empty, but for [`AssignmentPurpose::Collect`].
    pub whole_episodes: bool,
    /// `true` if the grouping chooses the policy that collects a rollout, from the first
    /// observations of its episodes ([`AssignmentPurpose::Collect`]).
    pub chooses_collector: bool,
}

/// Request to a grouping: to choose the policy that collects a rollout, to assign a rollout, to
/// recognise a policy, or to confirm one.
#[derive(Clone, Copy, Debug)]
pub enum AssignmentPurpose<'a> {
    /// Request for the policy that should collect a rollout, from the beginnings of its episodes,
    /// which have no steps yet. [`RolloutEpisodes::collector`] collects it unless the decision
    /// names another existing policy. There are no features of first frames. Groupings are asked
    /// that choose collectors ([`EpisodeRequirements::chooses_collector`]), where there are several
    /// policies and [`EpisodeRequirements::episodes`] environments.
    Collect,
    /// Request to assign one rollout to the policy that will train on it.
    Assign {
        /// `true` if the decision may be [`AssignedPolicy::Undecided`]: no policy trains on the
        /// rollout, and another one is collected.
        allow_undecided: bool,
        /// Availability of the collector's parameters from before its latest update, with which an
        /// undecided decision may ask it to act next ([`RequiredTrial::PreviousParameters`]).
        previous_parameters: PreviousParameters,
    },
    /// Request for the policy that fits one or more episodes, which are not used for training.
    Recognise,
    /// Request to confirm the policy that a decision proposed, from episodes that it collected
    /// itself. It only follows a decision that demands a [`RequiredTrial`].
    Confirm {
        /// Earlier decision, which proposed the policy on trial.
        proposal: &'a GroupingDecision,
        /// `true` if the decision may be [`AssignedPolicy::Undecided`], as for
        /// [`AssignmentPurpose::Assign`].
        allow_undecided: bool,
    },
}

/// Data for an assignment: the first frames of a rollout and those that every policy keeps, and the
/// whole episodes of the rollout.
pub trait AssignmentData {
    /// Returns for each policy the first frames that the policy keeps and those of the rollout, as
    /// features of the policy's network. This is slow, since networks embed every frame.
    ///
    /// # Errors
    /// Errors of a network.
    fn clouds(&mut self) -> Result<Vec<RolloutAndBufferFeatures>, LearnerError>;

    /// Returns two comparisons of the rollout with two policies, by their first frames of at most
    /// `most` episodes each: in the current features of the first policy, and in those of the
    /// second.
    ///
    /// # Errors
    /// Errors of a network.
    fn comparisons(
        &mut self,
        policies: [usize; 2],
        most: usize,
    ) -> Result<[NearerPolicyInputs; 2], LearnerError>;

    /// Returns the whole episodes of the rollout.
    fn episodes(&self) -> RolloutEpisodes<'_>;
}

/// Episodes of one or more rollouts, unfinished ones included, with the policy that acted in them.
#[derive(Clone, Copy, Debug)]
pub struct RolloutEpisodes<'a> {
    /// Specification of the environments in which the episodes ran.
    pub spec: &'a EnvSpec,
    /// Index of the policy that acted in the episodes.
    pub collector: usize,
    /// Whole episodes, for groupings that need them; an unfinished one is marked as such.
    pub trajectories: &'a [Trajectory],
}

/// Decision of a grouping on a rollout, with the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupingDecision {
    /// Policy that the rollout is assigned to: an existing one, a new one, or undecided.
    pub policy: AssignedPolicy,
    /// Index of the policy that fits best, accepted or not; `None` if nothing was compared.
    pub nearest: Option<usize>,
    /// Evidence for and against each policy; empty if nothing was compared.
    pub evidence: Vec<PolicyEvidence>,
    /// Changepoint, in decisions of all environments since the start of the rollout, if the rollout
    /// shows two task groups. Only the later group was judged, or in a trial only the earlier one,
    /// unless `group_changed`.
    pub changepoint: Option<usize>,
    /// `true` if the task group changed after the policy on trial was proposed: no policy may train
    /// on earlier rollouts.
    pub group_changed: bool,
    /// Trial that the named policy must pass, with episodes that it collects, before the decision
    /// is final. After [`RequiredTrial::PreviousParameters`] of an undecided decision, the policy
    /// that acted collects the next rollout with its parameters from before its latest update.
    pub trial: RequiredTrial,
    /// `true` if the named policy is provisional: there is evidence against it, so it must not
    /// train before its trial.
    pub is_provisional: bool,
    /// Indices of the policies that the evidence rejects for this task group, until the next
    /// iteration.
    pub rejected: Vec<usize>,
    /// Indices of the policies that first frames of the rollout reject for certain; empty for
    /// groupings that need no trials.
    pub differing: Vec<usize>,
    /// Indices of the policies that the evidence accepts, the named one included; empty for
    /// groupings that merge no policies.
    pub accepted: Vec<usize>,
}

impl From<PolicyAssignment> for GroupingDecision {
    /// Converts an assignment into a final decision on the whole rollout.
    fn from(assignment: PolicyAssignment) -> Self {
        Self {
            nearest: assignment.best_candidate(),
            evidence: assignment.evidence,
            ..Self::for_policy(assignment.decision)
        }
    }
}

impl GroupingDecision {
    /// Returns a final decision for `policy`, without evidence or trial.
    pub fn for_policy(policy: AssignedPolicy) -> Self {
        Self {
            policy,
            nearest: None,
            evidence: Vec::new(),
            changepoint: None,
            group_changed: false,
            trial: RequiredTrial::None,
            is_provisional: false,
            rejected: Vec::new(),
            differing: Vec::new(),
            accepted: Vec::new(),
        }
    }
}

/// Episodes that were assigned to a policy, by which a grouping updates its memory.
#[derive(Clone, Copy, Debug)]
pub enum GroupingUpdateInput<'a> {
    /// Rollout that `policy` is about to train on.
    Rollout {
        /// Index of the policy that is about to train.
        policy: usize,
        /// [`GroupingDecision::accepted`] of the last decision.
        accepted: &'a [usize],
        /// Episodes of the rollout that the policy trains on.
        episodes: RolloutEpisodes<'a>,
    },
    /// Episodes of the policies that [`GroupingUpdateResult::probe`] asked for, in the task group
    /// of `policy`.
    Probes {
        /// Index of the policy that trained on the task group.
        policy: usize,
        /// Episodes of all probes since the policy trained, in the order of the probes.
        probes: &'a [RolloutEpisodes<'a>],
    },
}

/// Result of [`Grouping::update`]: the usable part of a rollout, a policy that must act as a probe,
/// and merged policies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GroupingUpdateResult {
    /// Changepoint, in decisions of all environments since the start of the rollout, if its end
    /// shows another task group; later steps must not be used for training.
    pub changepoint: Option<usize>,
    /// Index of the policy that must act next, for [`EpisodeRequirements::episodes`], since it may
    /// serve the same task group. The grouping receives its episodes as
    /// [`GroupingUpdateInput::Probes`].
    pub probe: Option<usize>,
    /// For each policy, the index of the policy that it was merged into, if any; empty for
    /// groupings that merge no policies.
    pub merged_into: Vec<Option<usize>>,
}

/// Policy that fits some episodes best, whether or not the evidence accepts it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecognisedPolicy {
    /// Index of the policy that fits the episodes best.
    pub policy: usize,
    /// `true` if the evidence accepts this policy; otherwise no known policy fits.
    pub fits: bool,
}

impl From<&GroupingDecision> for RecognisedPolicy {
    /// Takes the policy that the decision names, or else the nearest one, or policy 0 if nothing
    /// was compared.
    fn from(decision: &GroupingDecision) -> Self {
        match decision.policy {
            AssignedPolicy::Existing(policy) => Self { policy, fits: true },
            AssignedPolicy::New | AssignedPolicy::Undecided => {
                Self { policy: decision.nearest.unwrap_or(0), fits: false }
            }
        }
    }
}

impl RecognisedPolicy {
    /// Returns the index of the recognised policy; `None` if the evidence does not accept it.
    pub fn accepted_policy(self) -> Option<usize> {
        self.fits.then_some(self.policy)
    }
}

//! Trait of all groupings, with their queries and answers.

use cluster::{Assignment, Candidate, Contest, Decision, Evidence};
use evidence::{Course, Trial};
use rand_chacha::ChaCha8Rng;
use rl::EnvSpec;
use serde_json::Value;

use crate::error::LearnerError;

/// Assignment of rollouts to policies (lines 8 to 14 of the paper's Algorithm 1).
///
/// Policy 0 exists from the start and takes the very first rollout without a query.
pub trait Grouping: Send {
    /// Returns the number and the kind of the episodes that the grouping needs for an assignment.
    /// The default needs the first frames of one episode.
    fn needs(&self) -> Needs {
        Needs { episodes: 1, whole_episodes: false }
    }

    /// Decides which policy the rollout in `candidates` belongs to: an existing one, a new one, or
    /// none yet. After [`Decision::New`] a policy is created, unless the query is
    /// [`Query::Recognition`].
    ///
    /// # Errors
    /// Frames or episodes that cannot be compared.
    fn assign(
        &mut self,
        query: Query<'_>,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError>;

    /// Remembers which episodes belong to the task group of a policy. The default remembers
    /// nothing.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn learn(&mut self, _: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        Ok(Learned::default())
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

/// Number and kind of the episodes that a grouping needs to assign a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// Number of episodes that a rollout must show, and that must be kept for a policy, at least 1.
    pub episodes: usize,
    /// `true` if the grouping uses whole episodes and not only their first frames.
    /// [`Episodes::courses`] are only collected if it does.
    pub whole_episodes: bool,
}

/// Query to a grouping, to assign episodes to a policy or to confirm one.
#[derive(Clone, Copy, Debug)]
pub enum Query<'a> {
    /// Request to assign one rollout to a policy.
    Rollout {
        /// `true` if the answer may be [`Decision::Undecided`]: no policy trains on the rollout,
        /// and another one is collected.
        can_wait: bool,
    },
    /// Request for the policy that fits one or more episodes, which are not used for training.
    Recognition,
    /// Request to confirm the policy that a decision named, from episodes that it collected itself.
    /// This query only follows a decision that demands a [`Trial`].
    Trial {
        /// Earlier decision, which named the policy on trial.
        earlier: &'a GroupingDecision,
        /// `true` if the answer may be [`Decision::Undecided`], as for [`Query::Rollout`].
        can_wait: bool,
    },
}

/// Experience that a grouping can use: the first frames of a rollout and those that every policy
/// keeps, and the whole episodes of the rollout.
pub trait Candidates {
    /// Returns for each policy the first frames that the policy keeps and those of the rollout, as
    /// features of the policy's network. This is slow, since networks embed every frame.
    ///
    /// # Errors
    /// Errors of a network.
    fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError>;

    /// Returns the first frames that two policies keep, of at most `most` episodes each, and those
    /// of the rollout, as points in feature space. The first contest is in the present features of
    /// the first policy, the second one in those of the second.
    ///
    /// # Errors
    /// Errors of a network.
    fn contests(&mut self, rivals: [usize; 2], most: usize) -> Result<[Contest; 2], LearnerError>;

    /// Returns the whole episodes of the rollout.
    fn episodes(&self) -> Episodes<'_>;
}

/// Whole episodes of one rollout or two, with the policy that acted in them.
#[derive(Clone, Copy, Debug)]
pub struct Episodes<'a> {
    /// Specification of the environments in which the episodes ran.
    pub spec: &'a EnvSpec,
    /// Index of the policy that acted in the episodes.
    pub collector: usize,
    /// Whole episodes, for groupings that need them; an unfinished one is marked as such.
    pub courses: &'a [Course],
}

/// Answer of a grouping to a query.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupingDecision {
    /// Policy that the rollout is assigned to: an existing one, a new one, or undecided.
    pub policy: Decision,
    /// Index of the policy that fits best, accepted or not; `None` if nothing was compared.
    pub nearest: Option<usize>,
    /// Evidence for and against each policy; empty if nothing was compared.
    pub evidence: Vec<Evidence>,
    /// Changepoint, in decisions of all environments since the start of the rollout, if the rollout
    /// shows two task groups. Only the later group was judged, or in a trial only the earlier one,
    /// unless `group_changed`.
    pub cut: Option<usize>,
    /// `true` if the task group changed after the policy on trial was proposed: no policy may train
    /// on earlier rollouts.
    pub group_changed: bool,
    /// Trial that the named policy must pass, with episodes that it collects, before the decision
    /// is final.
    pub trial: Trial,
    /// `true` if the named policy is provisional: there is evidence against it, so it must not
    /// train before its trial.
    pub is_provisional: bool,
    /// Indices of the policies that the evidence rejects for this task group, until the next
    /// iteration.
    pub rejected: Vec<usize>,
    /// Indices of the policies that the evidence accepts, the named one included; empty for
    /// groupings that merge no policies.
    pub accepted: Vec<usize>,
}

impl From<Assignment> for GroupingDecision {
    /// Converts an assignment into a final decision on the whole rollout.
    fn from(assignment: Assignment) -> Self {
        Self {
            nearest: assignment.nearest(),
            evidence: assignment.evidence,
            ..Self::of(assignment.decision)
        }
    }
}

impl GroupingDecision {
    /// Returns a final decision without evidence.
    pub fn of(policy: Decision) -> Self {
        Self {
            policy,
            nearest: None,
            evidence: Vec::new(),
            cut: None,
            group_changed: false,
            trial: Trial::None,
            is_provisional: false,
            rejected: Vec::new(),
            accepted: Vec::new(),
        }
    }
}

/// Episodes that a grouping remembers for a policy.
#[derive(Clone, Copy, Debug)]
pub enum Lesson<'a> {
    /// Rollout that `policy` is about to train on.
    Rollout {
        /// Index of the policy that is about to train.
        policy: usize,
        /// [`GroupingDecision::accepted`] of the last decision.
        accepted: &'a [usize],
        /// Episodes of the rollout that the policy trains on.
        episodes: Episodes<'a>,
    },
    /// Episodes of the policies that [`Learned::probe`] asked for, in the task group of `policy`.
    Probes {
        /// Index of the policy that trained on the task group.
        policy: usize,
        /// Episodes of all probes since the policy trained, in the order of the probes.
        probes: &'a [Episodes<'a>],
    },
}

/// Instructions of a grouping to the learner after a call of [`Grouping::learn`]. They end training
/// data at a changepoint, let a policy act as a probe, and name merged policies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Learned {
    /// Changepoint, in decisions of all environments since the start of the rollout, if its end
    /// shows another task group; later steps must not be used for training.
    pub end: Option<usize>,
    /// Index of the policy that must act next for [`Needs::episodes`], since it may serve the same
    /// task group. The grouping receives its episodes as [`Lesson::Probes`].
    pub probe: Option<usize>,
    /// For each policy, the index of the policy that it was merged into, if any; empty for
    /// groupings that merge no policies.
    pub merged_into: Vec<Option<usize>>,
}

/// Policy that episodes seem to belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recognised {
    /// Index of the policy that fits the episodes best.
    pub policy: usize,
    /// `true` if the evidence accepts this policy; otherwise none is known to fit.
    pub fits: bool,
}

impl From<&GroupingDecision> for Recognised {
    /// Takes the policy that the decision names, or else the nearest one, or policy 0 if nothing
    /// was compared.
    fn from(decision: &GroupingDecision) -> Self {
        match decision.policy {
            Decision::Existing(policy) => Self { policy, fits: true },
            Decision::New | Decision::Undecided => {
                Self { policy: decision.nearest.unwrap_or(0), fits: false }
            }
        }
    }
}

impl Recognised {
    /// Returns the index of the recognised policy; `None` if the evidence does not accept it.
    pub fn named(self) -> Option<usize> {
        self.fits.then_some(self.policy)
    }
}

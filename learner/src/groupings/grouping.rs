//! Trait of all groupings, with their queries and answers.

use cluster::{Assignment, Candidate, Contest, Decision, Evidence};
use evidence::Course;
use rand_chacha::ChaCha8Rng;
use rl::EnvSpec;
use serde_json::Value;

use crate::error::LearnerError;

/// Assignment of rollouts to policies (lines 8 to 14 of the paper's Algorithm 1).
///
/// Policy 0 exists from the start and takes the very first rollout without a query.
pub trait Grouping: Send {
    /// Returns the experience that a decision requires.
    fn needs(&self) -> Needs;

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

    /// Remembers which episodes belong to a policy. The default remembers nothing.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn learn(&mut self, _: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        Ok(Learned::default())
    }

    /// Returns the state for a checkpoint. The default has none.
    fn state(&self) -> Value {
        Value::Null
    }

    /// Restores the result of [`Grouping::state`] from a learner with `policies` policies.
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

/// Experience that a decision of a grouping requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// Number of episodes that a rollout must show, and a policy keep, at least 1.
    pub episodes: usize,
    /// `true` if the grouping uses whole episodes and not only their first frames.
    /// [`Episodes::courses`] are only collected if it does.
    pub whole_episodes: bool,
}

impl Needs {
    /// Least requirement: the first frames of one episode.
    pub const LEAST: Self = Self { episodes: 1, whole_episodes: false };
}

/// Question to a grouping.
#[derive(Clone, Copy, Debug)]
pub enum Query<'a> {
    /// The policy of one rollout. [`Decision::Undecided`] asks for one more.
    Rollout,
    /// The final policy of two rollouts, after the first one left the grouping undecided.
    TwoRollouts,
    /// The policy of episodes that are not used for training, perhaps only one.
    Recognition,
    /// Confirmation of the policy that this decision named, from episodes that it collected itself.
    /// This query only follows a decision that demands a [`Trial`].
    Trial(&'a GroupingDecision),
}

/// Experience that a grouping can use: the first frames of a rollout and of every policy.
pub trait Candidates {
    /// Returns for each policy the frames that it keeps and those of the rollout, in its own
    /// features. This is slow, since networks embed every frame.
    ///
    /// # Errors
    /// Errors of a network.
    fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError>;

    /// Returns two policies' frames, of at most `most` episodes each, and those of the rollout, in
    /// the present features of the one and then of the other.
    ///
    /// # Errors
    /// Errors of a network.
    fn contests(&mut self, rivals: [usize; 2], most: usize) -> Result<[Contest; 2], LearnerError>;

    /// Returns the time at which each episode of the rollout's frames began: decisions of all
    /// environments before it.
    fn began(&self) -> Vec<usize>;

    /// Returns the whole episodes of the rollout.
    fn episodes(&self) -> Episodes<'_>;
}

/// Episodes of one rollout or two.
#[derive(Clone, Copy, Debug)]
pub struct Episodes<'a> {
    /// Specification of the environments.
    pub spec: &'a EnvSpec,
    /// Index of the policy that acted.
    pub collector: usize,
    /// Episodes, for groupings that need whole ones; an unfinished one is marked as such.
    pub courses: &'a [Course],
}

/// Answer of a grouping to a query.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupingDecision {
    /// The policy that takes the rollout: an existing one, a new one, or undecided.
    pub policy: Decision,
    /// The policy that fits best, accepted or not; `None` if nothing was compared.
    pub nearest: Option<usize>,
    /// Evidence for each policy; empty if nothing was compared.
    pub evidence: Vec<Evidence>,
    /// Changepoint, in decisions, if the rollout shows two groups. Only the later group was judged,
    /// or in a trial only the earlier one.
    pub cut: Option<usize>,
    /// Trial that the named policy must pass once it acts, before the decision is final.
    pub trial: Trial,
    /// `true` if there is evidence against the named policy, so that it must not train before its
    /// trial.
    pub provisional: bool,
    /// Policies that are rejected until the next iteration.
    pub rejected: Vec<usize>,
    /// Policies that the evidence accepts, the named one included, of a grouping that merges
    /// policies.
    pub accepted: Vec<usize>,
}

impl From<Assignment> for GroupingDecision {
    /// Converts a final decision on the whole rollout.
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
            trial: Trial::None,
            provisional: false,
            rejected: Vec::new(),
            accepted: Vec::new(),
        }
    }
}

/// Trial of a policy that a grouping named in place of the one that acted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trial {
    /// No trial: the decision is final.
    #[default]
    None,
    /// One rollout that the policy collects itself.
    Rollout,
    /// A few episodes first, [`Needs::episodes`] and at least one in each environment, since
    /// several policies may fit; then one rollout.
    Episodes,
}

/// Episodes that a grouping remembers.
#[derive(Clone, Copy, Debug)]
pub enum Lesson<'a> {
    /// Rollout that `policy` is about to train on.
    Rollout {
        /// Index of the policy.
        policy: usize,
        /// [`GroupingDecision::accepted`] of the last decision.
        accepted: &'a [usize],
        /// Episodes of the rollout.
        episodes: Episodes<'a>,
    },
    /// Episodes of the policies that [`Learned::probe`] asked for, in the group of `policy`.
    Probes {
        /// Index of the policy that trained.
        policy: usize,
        /// All probes since then, in their order.
        probes: &'a [Episodes<'a>],
    },
}

/// Answer of a grouping to a lesson.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Learned {
    /// Changepoint, in decisions, if the end of the rollout shows another group; later steps must
    /// not be used for training.
    pub end: Option<usize>,
    /// Policy that must act next for [`Needs::episodes`], since it may serve the same group. The
    /// grouping receives its episodes as [`Lesson::Probes`].
    pub probe: Option<usize>,
    /// Policy that each one was merged into, if any; empty for groupings that merge no policies.
    pub merged_into: Vec<Option<usize>>,
}

/// Policy that episodes seem to belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recognised {
    /// Policy that fits the episodes best.
    pub policy: usize,
    /// `true` if the evidence accepts this policy; otherwise none is known to fit.
    pub fits: bool,
}

impl From<&GroupingDecision> for Recognised {
    /// Takes the named policy, or else the nearest one, or policy 0 if nothing was compared.
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
    /// Returns the policy if the evidence accepts it.
    pub fn named(self) -> Option<usize> {
        self.fits.then_some(self.policy)
    }
}

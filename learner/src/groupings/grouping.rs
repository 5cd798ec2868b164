//! The trait of all groupings, what one is asked, and what it answers.

use cluster::{Assignment, Candidate, Contest, Decision, Evidence};
use evidence::Course;
use rand_chacha::ChaCha8Rng;
use rl::EnvSpec;
use serde_json::Value;

use crate::error::LearnerError;

/// Decides which policy a rollout belongs to (lines 8 to 14 of the paper's Algorithm 1).
///
/// Policy 0 exists from the start and takes the first rollout of all; a grouping is asked from the
/// second one on.
pub trait Grouping: Send {
    /// Returns the experience that a decision takes.
    fn needs(&self) -> Needs;

    /// Decides which policy the candidates' rollout belongs to. A new policy that it names is
    /// opened, unless the query is [`Query::Recognition`].
    ///
    /// # Errors
    /// Frames or episodes that cannot be compared.
    fn assign(
        &mut self,
        query: Query<'_>,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError>;

    /// Learns which episodes belong to a policy; unless it is said otherwise, nothing is kept.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn learn(&mut self, _: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        Ok(Learned::default())
    }

    /// Returns everything that a checkpoint must hold of it: nothing, unless it is said otherwise.
    fn state(&self) -> Value {
        Value::Null
    }

    /// Takes back what [`Grouping::state`] returned when there were `policies` policies.
    ///
    /// # Errors
    /// Problem, in words.
    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        match state {
            Value::Null => Ok(()),
            other => Err(format!("got {other} of {policies} policies, expected none")),
        }
    }
}

/// Experience that a decision of a grouping takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// Episodes that a rollout must show, and a policy keep, at least 1.
    pub episodes: usize,
    /// Whether it looks at episodes beyond their first frames. [`Episodes::courses`] are collected
    /// for such groupings alone.
    pub whole_episodes: bool,
}

impl Needs {
    /// Needs nothing but one episode's first frames.
    pub const LEAST: Self = Self { episodes: 1, whole_episodes: false };
}

/// Question to a grouping.
#[derive(Clone, Copy, Debug)]
pub enum Query<'a> {
    /// The policy of one rollout. [`Decision::Undecided`] asks for one more.
    Rollout,
    /// The policy of two rollouts, for good, after the first one left the grouping undecided.
    TwoRollouts,
    /// The policy of episodes that nothing is learnt from. One episode must do.
    Recognition,
    /// Whether the policy that this decision named stays, judged by episodes that it collected
    /// itself. It is only asked where the decision demands a [`Trial`].
    Trial(&'a GroupingDecision),
}

/// Experience that a grouping may look at: the first frames of a rollout and of every policy.
pub trait Candidates {
    /// Returns for each policy the frames that it keeps and those of the rollout, in its own
    /// features. Costly: networks embed every frame.
    ///
    /// # Errors
    /// Those of a network.
    fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError>;

    /// Returns two policies' frames, of at most `most` episodes each, and those of the rollout, in
    /// the features of the one and then of the other, as both are now.
    ///
    /// # Errors
    /// Those of a network.
    fn contests(&mut self, rivals: [usize; 2], most: usize) -> Result<[Contest; 2], LearnerError>;

    /// Returns when each of the rollout's episodes began whose frames these are: decisions of all
    /// environments before it.
    fn began(&self) -> Vec<usize>;

    /// Returns the episodes of the rollout as they ran.
    fn episodes(&self) -> Episodes<'_>;
}

/// Episodes of one rollout or two.
#[derive(Clone, Copy, Debug)]
pub struct Episodes<'a> {
    /// The environments.
    pub spec: &'a EnvSpec,
    /// The policy that acted.
    pub collector: usize,
    /// The episodes, for groupings that need whole ones; one that was not seen to its end is marked
    /// so.
    pub courses: &'a [Course],
}

/// Answer of a grouping, with everything that the learner must know of it.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupingDecision {
    /// The policy that takes the rollout: an existing one, a new one, or undecided.
    pub policy: Decision,
    /// The policy that fits best, accepted or not; none where nothing was compared.
    pub nearest: Option<usize>,
    /// Evidence for each policy; empty where nothing was compared.
    pub evidence: Vec<Evidence>,
    /// Where the rollout shows two groups, the decisions before the later one, which alone was
    /// judged; of a trial, the earlier one.
    pub cut: Option<usize>,
    /// Proof that the named policy owes once it has taken over.
    pub trial: Trial,
    /// Whether the evidence speaks against the named policy, so that it may not learn before its
    /// trial.
    pub provisional: bool,
    /// Policies that are out of the question until the next iteration.
    pub rejected: Vec<usize>,
    /// Policies that the evidence accepts, the named one included, of a grouping that merges
    /// policies.
    pub accepted: Vec<usize>,
}

impl From<Assignment> for GroupingDecision {
    /// Takes a decision for good, on the whole rollout.
    fn from(assignment: Assignment) -> Self {
        Self {
            nearest: assignment.nearest(),
            evidence: assignment.evidence,
            ..Self::of(assignment.decision)
        }
    }
}

impl GroupingDecision {
    /// Returns a decision that rests on no evidence.
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

/// Proof that a policy owes which a grouping named in the place of the one that acted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trial {
    /// None: the decision is for good.
    #[default]
    None,
    /// The rollout that it collects itself.
    Rollout,
    /// Several policies may be meant: a few episodes, [`Needs::episodes`] and at least one in each
    /// environment, and then that rollout.
    Episodes,
}

/// Episodes that a grouping learns from.
#[derive(Clone, Copy, Debug)]
pub enum Lesson<'a> {
    /// `policy` is about to learn from this rollout.
    Rollout {
        /// The policy.
        policy: usize,
        /// [`GroupingDecision::accepted`] of the last decision.
        accepted: &'a [usize],
        /// The rollout.
        episodes: Episodes<'a>,
    },
    /// The policies that [`Learned::probe`] asked for acted where `policy` is at home.
    Probes {
        /// The policy that learnt.
        policy: usize,
        /// All probes since then, in their order.
        probes: &'a [Episodes<'a>],
    },
}

/// Answer of a grouping to a lesson.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Learned {
    /// Where the end of the rollout shows another group, the decisions before it: what follows is
    /// not to be learnt from.
    pub end: Option<usize>,
    /// A policy that is to act next for [`Needs::episodes`], since it may serve the same group.
    /// [`Lesson::Probes`] tells the grouping what came of it.
    pub probe: Option<usize>,
    /// For each policy the one that acts for its group since the two were merged; empty for
    /// groupings that merge no policies.
    pub merged_into: Vec<Option<usize>>,
}

/// The policy that episodes seem to belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recognised {
    /// The policy that fits best.
    pub policy: usize,
    /// Whether it may be the right one; otherwise none of the policies is known to fit.
    pub fits: bool,
}

impl From<&GroupingDecision> for Recognised {
    /// Takes the policy that was named; the nearest where none was, or policy 0 where nothing was
    /// compared.
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
    /// Returns the policy that is taken for the right one.
    pub fn named(self) -> Option<usize> {
        self.fits.then_some(self.policy)
    }
}

//! What every grouping can do.

use cluster::{Assignment, Candidate, Contest, Decision};
use evidence::{Course, Merge};
use rand_chacha::ChaCha8Rng;
use rl::EnvSpec;
use serde_json::Value;

use crate::error::CoversError;

/// What a grouping decides, or why it could not.
pub(crate) type Answer = Result<Assignment, CoversError>;

/// What a grouping may look at: the first frames of a rollout beside those of every policy.
pub trait Candidates {
    /// For each policy the frames that it keeps and those of the rollout, in its own features.
    /// Costly: networks embed every frame.
    ///
    /// # Errors
    /// What a network says.
    fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError>;

    /// Two policies' frames, of at most `most` episodes each, and those of the rollout, in the
    /// features of the one and then of the other, as both are now.
    ///
    /// # Errors
    /// What a network says.
    fn contests(&mut self, rivals: [usize; 2], most: usize) -> Result<[Contest; 2], CoversError>;

    /// When each of the rollout's episodes began whose frames these are: decisions of all
    /// environments before it.
    fn began(&self) -> Vec<usize>;

    /// The episodes of the rollout as they ran.
    fn episodes(&self) -> Episodes<'_>;
}

/// Episodes of one rollout or two.
#[derive(Clone, Copy, Debug)]
pub struct Episodes<'a> {
    /// The environments.
    pub spec: &'a EnvSpec,
    /// The policy that acted.
    pub collector: usize,
    /// The episodes; what was not seen to its end is marked so.
    pub courses: &'a [Course],
}

/// The policy that episodes seem to belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recognised {
    /// The policy that fits best.
    pub policy: usize,
    /// Whether it may be the right one; otherwise none of the policies is known to fit.
    pub fits: bool,
}

impl Recognised {
    /// The policy that an assignment names; the nearest where it names none, or policy 0 where no
    /// distances were measured.
    pub(super) fn of(assignment: &Assignment) -> Self {
        match assignment.decision {
            Decision::Existing(policy) => Self { policy, fits: true },
            Decision::New | Decision::Undecided => Self {
                policy: assignment.nearest().unwrap_or(0),
                fits: false,
            },
        }
    }

    /// The policy that is taken for the right one.
    pub fn named(self) -> Option<usize> {
        self.fits.then_some(self.policy)
    }
}

/// Decides which policy a rollout belongs to (lines 8 to 15 of the paper's Algorithm 1).
///
/// Policy 0 exists from the start and takes the first rollout of all; a grouping is asked from the
/// second one on.
pub trait Grouping: Send {
    /// Episodes that a rollout must show, and a policy keep, at least 1.
    fn min_episodes(&self) -> usize;

    /// Decides on one rollout; `Undecided` asks for one more, and [`Grouping::settle`].
    ///
    /// # Errors
    /// Frames that cannot be compared.
    fn assign(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer;

    /// Decides for good on two rollouts, after [`Grouping::assign`] was undecided on the first.
    ///
    /// # Errors
    /// Frames that cannot be compared.
    fn settle(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        self.assign(candidates, rng)
    }

    /// Names the policy of episodes that nothing is learnt from, one or more: fewer than
    /// [`Grouping::min_episodes`] must do, too.
    ///
    /// # Errors
    /// Frames that cannot be compared.
    fn recognise(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Recognised, CoversError> {
        Ok(Recognised::of(&self.assign(candidates, rng)?))
    }

    /// The policies that the last decision put out of question in this matter.
    fn refused(&self) -> Vec<usize> {
        Vec::new()
    }

    /// Where the last decision rests on a part of the episodes alone, since they show two groups:
    /// the decisions before the later group. A look decides on the later part, and
    /// [`Grouping::review`] on the earlier one.
    fn cut(&self) -> Option<usize> {
        None
    }

    /// Whether what the last decision saw speaks against the policy that it named, which must show
    /// by acting that it is meant.
    fn is_unproven(&self) -> bool {
        false
    }

    /// Judges the policy that a decision named, by a rollout that it collected itself: names
    /// another one or a new one, or nothing where it stays. `refused` lists those that are out of
    /// question, [`Grouping::refused`] to begin with, and those that this call adds.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn review(
        &self,
        _candidates: &mut dyn Candidates,
        _refused: &mut Vec<usize>,
        _rng: &mut ChaCha8Rng,
    ) -> Result<Option<Assignment>, CoversError> {
        Ok(None)
    }

    /// Whether the policy that the last decision named is one of several that might be meant: it is
    /// worth while to let it act for [`Grouping::min_episodes`], at least one in each environment,
    /// and to review that, before it collects a rollout.
    fn is_contested(&self) -> bool {
        false
    }

    /// Learns which episodes policy `index` is about to learn from. Where their end shows another
    /// group, returns the number of decisions before it: what follows is not to be learnt from.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn remember(
        &mut self,
        _index: usize,
        _episodes: Episodes<'_>,
        _rng: &mut ChaCha8Rng,
    ) -> Result<Option<usize>, CoversError> {
        Ok(None)
    }

    /// A policy that may serve the same group as policy `index`, which the last decision accepted:
    /// it is to act for [`Grouping::min_episodes`], and [`Grouping::compare`] is to judge it.
    fn twin(&self, _index: usize) -> Option<usize> {
        None
    }

    /// Whether `twin`, which collected these episodes where policy `index` is at home, serves there
    /// as well. Policy `index` then acts, too, for [`Grouping::merge`].
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn compare(
        &mut self,
        _index: usize,
        _twin: usize,
        _episodes: Episodes<'_>,
        _rng: &mut ChaCha8Rng,
    ) -> Result<bool, CoversError> {
        Ok(false)
    }

    /// Makes one of two policies the heir of the other one by the episodes that `twin` collected,
    /// unless those that policy `index` collected after them say otherwise: returns the one that
    /// goes on, and the one that has an heir.
    ///
    /// # Errors
    /// Episodes that cannot be compared.
    fn merge(
        &mut self,
        _index: usize,
        _twin: usize,
        _episodes: [Episodes<'_>; 2],
        _rng: &mut ChaCha8Rng,
    ) -> Result<Option<Merge>, CoversError> {
        Ok(None)
    }

    /// For each policy the one that acts for its group since the two were merged; none where no
    /// policies are ever merged.
    fn heirs(&self) -> Option<Vec<Option<usize>>> {
        None
    }

    /// Learns that policy `index` took the last rollout.
    fn adopt(&mut self, _: usize) {}

    /// What must be remembered in a checkpoint: nothing, if it is not said.
    fn state(&self) -> Value {
        Value::Null
    }

    /// Takes back what [`Grouping::state`] returned when there were `policies` policies.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        match state {
            Value::Null => Ok(()),
            other => Err(format!("got {other} of {policies} policies, expected none")),
        }
    }
}

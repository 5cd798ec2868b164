//! Evidence for and against one policy: sources of evidence (pictures, motion, returns) and their
//! joint permutation test.

use std::fmt;

use cluster::{Candidate, Evidence, Frames, JointTest, Side, Source, SourceTest, Verdict};

use crate::account::Account;
use crate::error::Result;

/// Number of standard deviations that a change of motion by 100 % counts as in the outlier score of
/// a policy.
const MOTION_WEIGHT: f64 = 10.0;

/// Source of evidence: what is compared between two sets of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Picture,
    Vector,
    Motion,
    Slope,
    Earnings,
}

impl Kind {
    /// Sources of evidence that do not depend on actions: first picture and first observation
    /// vector.
    pub(crate) const LOOKS: &'static [Self] = &[Self::Picture, Self::Vector];
    pub(crate) const ALL: &'static [Self] =
        &[Self::Picture, Self::Vector, Self::Motion, Self::Slope, Self::Earnings];

    /// Returns `true` for sources of evidence that do not depend on actions: first picture and
    /// first observation vector.
    pub(crate) fn is_look(self) -> bool {
        matches!(self, Self::Picture | Self::Vector)
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Vector => "vector",
            Self::Motion => "motion",
            Self::Slope => "slope",
            Self::Earnings => "earnings",
        }
    }

    pub(crate) fn point(self, account: &Account) -> Option<&[f32]> {
        match self {
            Self::Picture => Some(&account.picture),
            Self::Vector => Some(&account.vector),
            Self::Motion => account.motion.as_deref(),
            Self::Slope => account.slope.as_deref(),
            Self::Earnings => account.earned.as_ref().map(std::slice::from_ref),
        }
    }
}

/// Stage of a decision on the policy of a rollout, by the number of rollouts that it rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// First look, at one rollout: a doubt asks for another one.
    First,
    /// Final look, at two rollouts or at one that the tested policy collected itself: the decision
    /// is final.
    Second,
}

/// Relation of a tested policy to the tested episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Policy that did not act in the tested episodes.
    Stranger,
    /// Policy that acted and continues the task that it trained on last.
    Stays,
    /// Policy that acted after a time without training: its task group may have drifted meanwhile.
    Returns,
    /// Policy that acted although pictures or vectors rejected it: its returns must show that it
    /// serves the task group, as far as they rose in training.
    Provisional,
}

/// Evidence for and against one policy in a decision.
#[derive(Clone, Debug, PartialEq)]
pub struct Opinion {
    /// Verdict on the policy, after all tests.
    pub verdict: Verdict,
    /// Joint test of all sources of evidence; `None` if the policy remembers too few episodes.
    pub test: Option<JointTest>,
    /// Sources of evidence of the joint test, in the order of its results.
    pub(crate) kinds: &'static [Kind],
    /// Relative change of motion (response of the observation vector to actions) from the
    /// remembered to the tested episodes; 0 if it is unknown.
    pub changed: f64,
    /// Relative change of slope (direction of actions that increases the reward) from the
    /// remembered to the tested episodes.
    pub(crate) turned: f64,
    /// Share of the policy's gain in return that the tested episodes did not earn.
    pub(crate) lost: f64,
    /// Standard error of `lost`, the lost share of the gain in return.
    pub(crate) lost_error: f64,
    /// Rise of the policy's return since its first rollout, in standard deviations of the return.
    pub(crate) gain: f64,
    /// Rise of the return of the tested episodes over the policy's first rollout, in standard
    /// deviations of the return.
    pub(crate) episode_gain: f64,
    pub(crate) role: Role,
}

impl Opinion {
    /// Converts the opinion to the evidence type of the crate `cluster`, with the distance of the
    /// first source that was tested.
    pub fn evidence(&self) -> Evidence {
        Evidence {
            distance: self.sources().next().map_or(0.0, |(_, source)| source.distance),
            test: self.test.as_ref().map(|test| test.overall),
            verdict: self.verdict,
        }
    }

    /// Returns the smallest p-value of a source by the fitted Pearson tail, adjusted for the number
    /// of sources; 1 if nothing was tested.
    pub fn tail_p_value(&self) -> f64 {
        self.test.as_ref().map_or(1.0, |test| test.overall.tail_p_value)
    }

    pub(crate) fn is_rejected(&self) -> bool {
        self.verdict == Verdict::Rejected
    }

    /// Returns the largest standardised distance of pictures and vectors; infinity for a policy
    /// that was not tested, so that it ranks last.
    pub(crate) fn look_score(&self) -> f64 {
        if self.test.is_none() {
            return f64::INFINITY;
        }
        let looks = self.sources().filter(|(kind, _)| kind.is_look());
        let scores = looks.map(|(_, source)| source.score);
        scores.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the largest ratio of the distance of pictures or vectors to its mean over random
    /// splits; 0 if neither was tested.
    pub(crate) fn look_ratio(&self) -> f64 {
        let looks = self.sources().filter(|(kind, _)| kind.is_look());
        looks.map(|(_, source)| source.ratio()).fold(0.0, f64::max)
    }

    /// Returns an outlier score, by which policies are ranked: of pictures and vectors, and for
    /// policies that they do not separate also of motion, which hardly depends on the acting
    /// policy.
    pub(crate) fn misfit(&self) -> f64 {
        self.look_score() + MOTION_WEIGHT * self.changed
    }

    /// Returns `true` if pictures or vectors reject the policy at the significance level `level`.
    pub(crate) fn looks_doubtful(&self, level: f64) -> bool {
        self.sources().any(|(kind, source)| kind.is_look() && is_doubtful(source, level))
    }

    /// Returns the sources of evidence with a test result; one whose pooled points are all equal
    /// has none.
    pub(crate) fn sources(&self) -> impl Iterator<Item = (Kind, &SourceTest)> {
        self.test.iter().flat_map(|test| self.sources_of(test))
    }

    /// Returns the sources of evidence with a result in a test that may still run.
    pub(crate) fn sources_of<'a>(
        &'a self,
        test: &'a JointTest,
    ) -> impl Iterator<Item = (Kind, &'a SourceTest)> {
        let pairs = self.kinds.iter().zip(&test.sources);
        pairs.filter_map(|(&kind, source)| Some((kind, source.as_ref()?)))
    }
}

/// Prints the verdict on a policy and the test results of all sources in one line.
impl fmt::Display for Opinion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.verdict)?;
        for (kind, source) in self.sources() {
            let (name, tail) = (kind.name(), source.tail_p_value);
            write!(f, " {name} {:.1} ({:.2}, p {tail:.0e})", source.score, source.ratio())?;
        }
        let Self { changed, turned, lost, gain, episode_gain, .. } = self;
        write!(f, " changed {changed:.2} turned {turned:.2} lost {lost:.2}")?;
        write!(f, " gain {gain:.1} of these episodes {episode_gain:.1}")
    }
}

/// Share of the significance level at which a p-value by the fitted tail is certain enough to end a
/// permutation test early.
pub(crate) const SURE: f64 = 1e-3;

/// Returns `true` if a source shows a difference at the significance level `level`: by its exact
/// p-value, or with certainty by its fitted tail, if the test ended before exact p-values were fine
/// enough.
pub(crate) fn is_doubtful(source: &SourceTest, level: f64) -> bool {
    source.p_value <= level || source.tail_p_value <= SURE * level
}

/// Returns the distance between the mean points of one source in two lists of episodes, relative to
/// the norm of the second mean; 0 if either is unknown.
pub(crate) fn changed(accounts: &[&Account], remembered: &[&Account], kind: Kind) -> f64 {
    match (mean_of(accounts, kind), mean_of(remembered, kind)) {
        (Some(now), Some(home)) if now.len() == home.len() => {
            let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
            let apart = norm(&mut now.iter().zip(&home).map(|(now, home)| now - home));
            (apart / norm(&mut home.iter().copied()).max(f64::MIN_POSITIVE)).sqrt()
        }
        _ => 0.0,
    }
}

fn mean_of(accounts: &[&Account], kind: Kind) -> Option<Vec<f64>> {
    let known: Vec<&[f32]> = accounts.iter().filter_map(|a| kind.point(a)).collect();
    let mut mean = vec![0.0; known.first()?.len()];
    for motion in &known {
        for (sum, &entry) in mean.iter_mut().zip(motion.iter()) {
            *sum += f64::from(entry) / known.len() as f64;
        }
    }
    Some(mean)
}

pub(crate) fn mean_earned<'a>(accounts: impl Iterator<Item = &'a Account>) -> Option<f64> {
    let earned: Vec<f64> = accounts.filter_map(|a| a.earned.map(f64::from)).collect();
    (!earned.is_empty()).then(|| earned.iter().sum::<f64>() / earned.len() as f64)
}

/// Returns the summaries of episodes recorded to their end, since all sources need the same
/// episodes; `None` if these are fewer than `least` or than half of all.
pub(crate) fn whole<'a>(accounts: &[&'a Account], least: usize) -> Option<Vec<&'a Account>> {
    let is_whole = |account: &&&Account| account.motion.is_some() && account.earned.is_some();
    let whole: Vec<&Account> = accounts.iter().filter(is_whole).copied().collect();
    (whole.len() >= least && 2 * whole.len() >= accounts.len()).then_some(whole)
}

/// Returns the points of one source as frames of one-frame episodes.
pub(crate) fn frames(accounts: &[&Account], kind: Kind) -> Result<Frames> {
    let points: Vec<&[f32]> = accounts.iter().filter_map(|a| kind.point(a)).collect();
    let dim = points.first().map_or(0, |point| point.len());
    Ok(Frames::new(points.concat(), 1, dim)?)
}

/// Returns for each source of evidence the points of the rollout's episodes and those of the
/// remembered ones.
pub(crate) fn sources(
    kinds: &[Kind],
    rollout: &[&Account],
    remembered: &[&Account],
) -> Result<Vec<Source>> {
    let source = |&kind: &Kind| {
        let (rollout, buffer) = (frames(rollout, kind)?, frames(remembered, kind)?);
        // a policy that earns more than it remembers serves the group all the same
        let side = if kind == Kind::Earnings { Side::Less } else { Side::Both };
        Ok(Source { clouds: Candidate { buffer, rollout }, side })
    };
    kinds.iter().map(source).collect()
}

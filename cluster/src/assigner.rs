//! Unsupervised policy assignment (lines 8-15 of the paper's Algorithm 1).

use rand::Rng;

use crate::ClusterError;
use crate::frames::Candidate;
use crate::permutation::{PermutationTest, permutation_test};
use crate::settings::{AssignerSettings, Calibrated, Rule};
use crate::wasserstein::wasserstein1;

/// Which policy takes the rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// The candidate of this index.
    Existing(usize),
    /// No candidate fits: the rollout seeds a policy of its own.
    New,
}

/// How the distance of a candidate was judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Judgement {
    /// Against a fixed threshold.
    Threshold,
    /// Against random splits of the pooled episodes.
    Tested(PermutationTest),
    /// Not at all: the buffer holds too few episodes for a test. Such a candidate is accepted,
    /// since nothing speaks against it, but only taken if no tested candidate is accepted.
    BufferTooSmall {
        /// Episodes in the buffer.
        episodes: usize,
        /// Episodes that the settings ask for.
        needed: usize,
    },
}

/// What speaks for and against one candidate; a log of these is what limits are tuned on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// `W1` between rollout and buffer (under [`Judgement::Tested`]: the sampled episodes), in the
    /// features' unit.
    pub distance: f64,
    /// How the distance was judged.
    pub judgement: Judgement,
    /// Whether the rollout may belong to this candidate's group.
    pub accepted: bool,
}

impl Evidence {
    /// Returns the score in standard deviations, where a test was made.
    pub fn score(&self) -> Option<f64> {
        self.test().map(|test| test.score)
    }

    /// Returns the ratio of the distance to the largest permuted one, where a test was made.
    pub fn ratio(&self) -> Option<f64> {
        self.test().map(|test| test.ratio)
    }

    fn test(&self) -> Option<&PermutationTest> {
        match &self.judgement {
            Judgement::Tested(test) => Some(test),
            Judgement::Threshold | Judgement::BufferTooSmall { .. } => None,
        }
    }

    /// Sorts candidates: tested ones by score, then the others by distance.
    fn rank(&self) -> (bool, f64) {
        match self.score() {
            Some(score) => (false, score),
            None => (true, self.distance),
        }
    }
}

/// A decision and its evidence, one item a candidate, in the candidates' order.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// Which policy takes the rollout.
    pub decision: Decision,
    /// Evidence for each candidate.
    pub evidence: Vec<Evidence>,
}

/// Assigns rollouts to policies by 1-Wasserstein distances in feature space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Assigner {
    settings: AssignerSettings,
}

impl Assigner {
    /// Takes checked settings.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: AssignerSettings) -> Result<Self, ClusterError> {
        settings.check()?;
        Ok(Self { settings })
    }

    /// Returns the settings.
    pub fn settings(&self) -> &AssignerSettings {
        &self.settings
    }

    /// Compares the rollout with each candidate's buffer, in that candidate's own feature space,
    /// and decides.
    ///
    /// The accepted candidate with the lowest score wins (with the lowest distance under
    /// [`Rule::Fixed`]); the first of equals. Without candidates the decision is [`Decision::New`].
    /// Only the calibrated rule draws from `rng`; equal generators give equal results.
    ///
    /// # Errors
    /// Clouds that cannot be compared, or a rollout of fewer than `min_episodes` under the
    /// calibrated rule.
    pub fn assign<R: Rng + ?Sized>(
        &self,
        candidates: &[Candidate],
        rng: &mut R,
    ) -> Result<Assignment, ClusterError> {
        let mut evidence = Vec::with_capacity(candidates.len());
        for (index, candidate) in candidates.iter().enumerate() {
            candidate.check(index)?;
            evidence.push(self.judge(candidate, rng)?);
        }
        let decision = decide(&evidence);
        Ok(Assignment { decision, evidence })
    }

    fn judge<R: Rng + ?Sized>(
        &self,
        candidate: &Candidate,
        rng: &mut R,
    ) -> Result<Evidence, ClusterError> {
        match &self.settings.rule {
            Rule::Fixed { threshold } => judge_fixed(candidate, *threshold),
            Rule::Calibrated(settings) => judge_calibrated(candidate, settings, rng),
        }
    }
}

fn distance(candidate: &Candidate) -> Result<f64, ClusterError> {
    let (o, b) = (&candidate.rollout, &candidate.buffer);
    wasserstein1(o.features(), b.features(), o.dim())
}

fn judge_fixed(candidate: &Candidate, threshold: f64) -> Result<Evidence, ClusterError> {
    let distance = distance(candidate)?;
    let accepted = distance <= threshold;
    Ok(Evidence {
        distance,
        judgement: Judgement::Threshold,
        accepted,
    })
}

fn judge_calibrated<R: Rng + ?Sized>(
    candidate: &Candidate,
    settings: &Calibrated,
    rng: &mut R,
) -> Result<Evidence, ClusterError> {
    let needed = settings.min_episodes;
    let episodes = candidate.rollout.episodes();
    if episodes < needed {
        return Err(ClusterError::RolloutTooSmall { episodes, needed });
    }
    let episodes = candidate.buffer.episodes();
    if episodes < needed {
        let judgement = Judgement::BufferTooSmall { episodes, needed };
        return Ok(Evidence {
            distance: distance(candidate)?,
            judgement,
            accepted: true,
        });
    }
    let test = permutation_test(candidate, settings, rng)?;
    let accepted = settings.accepts(&test);
    Ok(Evidence {
        distance: test.distance,
        judgement: Judgement::Tested(test),
        accepted,
    })
}

fn decide(evidence: &[Evidence]) -> Decision {
    let accepted = evidence.iter().enumerate().filter(|(_, e)| e.accepted);
    let best = accepted.min_by(|(_, a), (_, b)| {
        let ((a_last, a), (b_last, b)) = (a.rank(), b.rank());
        a_last.cmp(&b_last).then(a.total_cmp(&b))
    });
    best.map_or(Decision::New, |(index, _)| Decision::Existing(index))
}

//! Unsupervised policy assignment (lines 8-15 of the paper's Algorithm 1).

use rand::Rng;

use crate::change::{change_places, change_test};
use crate::check::within;
use crate::error::{ClusterError, Result};
use crate::frames::Candidate;
use crate::permutation::{PermutationTest, permutation_test};
use crate::settings::{AssignerSettings, Calibrated, Rule};
use crate::wasserstein::wasserstein1;

/// Policy that a rollout is assigned to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Existing policy, by its index among the candidates.
    Existing(usize),
    /// New policy, since no candidate fits.
    New,
    /// No policy yet: no candidate fits, but one rollout is too little to create a policy. Collect
    /// one more of the same unknown task, and pass the episodes of both to [`Assigner::settle`].
    Undecided,
}

/// Outcome of the comparison of a rollout with one candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Rollout that may belong to the candidate's task group.
    Accepted,
    /// Rollout that probably does not belong to the candidate's task group; a second look decides.
    Doubted,
    /// Rollout that does not belong to the candidate's task group.
    Rejected,
}

/// Criterion that the distance of a candidate was compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Judgement {
    /// Fixed threshold of the distance.
    Threshold {
        /// Largest accepted distance, in the features' unit.
        limit: f64,
    },
    /// Permutation test: random splits of the pooled episodes.
    Tested {
        /// Result of the test.
        test: PermutationTest,
        /// Largest p-value that counts against the candidate.
        limit: f64,
    },
    /// No test, since the buffer holds too few episodes. Such a candidate is accepted for lack of
    /// evidence against it, but only taken if no tested candidate is accepted.
    BufferTooSmall {
        /// Number of episodes in the candidate's buffer.
        episodes: usize,
        /// Number of episodes that the settings ask for.
        needed: usize,
    },
}

/// Evidence for and against the assignment of a rollout to one candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// 1-Wasserstein distance between rollout and buffer, in the features' unit; of the sampled
    /// episodes under [`Judgement::Tested`].
    pub distance: f64,
    /// Criterion that the distance was compared with.
    pub judgement: Judgement,
    /// Outcome of the comparison of the rollout with the candidate.
    pub verdict: Verdict,
}

impl Evidence {
    /// Returns the permutation test of the candidate, if there was one.
    pub fn test(&self) -> Option<&PermutationTest> {
        match &self.judgement {
            Judgement::Tested { test, .. } => Some(test),
            Judgement::Threshold { .. } | Judgement::BufferTooSmall { .. } => None,
        }
    }

    /// Returns the standardised distance, in standard deviations over random splits, if there was a
    /// test.
    pub fn score(&self) -> Option<f64> {
        self.test().map(|test| test.score)
    }

    /// Returns the sort key of a candidate: tested ones by score, then the others by distance.
    fn rank(&self) -> (bool, f64) {
        match self.score() {
            Some(score) => (false, score),
            None => (true, self.distance),
        }
    }
}

/// Decision on a rollout, with the evidence for each candidate.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// Policy that the rollout is assigned to.
    pub decision: Decision,
    /// Evidence for and against each candidate, in the order of the candidates.
    pub evidence: Vec<Evidence>,
}

impl Assignment {
    /// Returns the index of the candidate that fits best, accepted or not; `None` without
    /// candidates.
    pub fn nearest(&self) -> Option<usize> {
        best(&self.evidence, |_| true)
    }

    /// Returns the two tested candidates that fit best, accepted or not, the better one first;
    /// `None` if fewer were tested.
    pub fn rivals(&self) -> Option<[usize; 2]> {
        let tested = |e: &Evidence| e.test().is_some();
        let first = best(&self.evidence, tested)?;
        let others = (0..self.evidence.len()).filter(|&index| index != first);
        let others: Vec<_> = others.collect();
        let evidence: Vec<_> = others.iter().map(|&index| self.evidence[index]).collect();
        let second = best(&evidence, tested)?;
        Some([first, others[second]])
    }
}

/// Assigner of rollouts to policies by 1-Wasserstein distances in feature space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Assigner {
    settings: AssignerSettings,
}

/// Look at a group: the first has one rollout, the second has two and is final.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Look {
    First,
    Second,
}

impl Assigner {
    /// Creates an assigner after checking its settings.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: AssignerSettings) -> Result<Self> {
        settings.check()?;
        Ok(Self { settings })
    }

    /// Returns the settings of the assigner.
    pub fn settings(&self) -> &AssignerSettings {
        &self.settings
    }

    /// Compares one rollout with each candidate's buffer, in that candidate's own feature space,
    /// and decides which one it belongs to.
    ///
    /// The accepted candidate with the lowest score wins (with the lowest distance under
    /// [`Rule::Fixed`]); the first of equals. If none is accepted, the calibrated rule answers
    /// [`Decision::Undecided`] and the fixed one [`Decision::New`]. Without candidates the decision
    /// is [`Decision::New`]. Only the calibrated rule draws from `rng`; equal generators give equal
    /// results.
    ///
    /// # Errors
    /// Clouds that cannot be compared, or a rollout of fewer than `min_episodes` under the
    /// calibrated rule.
    pub fn assign(&self, candidates: &[Candidate], rng: &mut impl Rng) -> Result<Assignment> {
        self.check_rollouts(candidates)?;
        self.look(Look::First, candidates, rng)
    }

    /// Decides as [`assign`](Self::assign) does, on rollouts of any number of episodes: one is
    /// enough to name the candidate that fits best. The fewer there are, the less evidence
    /// can reject a candidate.
    ///
    /// # Errors
    /// Clouds that cannot be compared.
    pub fn recognise(&self, candidates: &[Candidate], rng: &mut impl Rng) -> Result<Assignment> {
        self.look(Look::First, candidates, rng)
    }

    /// Decides as [`assign`](Self::assign) does, but for good, after it was undecided: the rollouts
    /// of the candidates hold the episodes of the first rollout and of one more.
    ///
    /// # Errors
    /// Errors of [`assign`](Self::assign).
    pub fn settle(&self, candidates: &[Candidate], rng: &mut impl Rng) -> Result<Assignment> {
        self.check_rollouts(candidates)?;
        self.look(Look::Second, candidates, rng)
    }

    /// Returns the changepoint if the candidates' rollouts show two groups: the time at which the
    /// first episode of the later group began. `began` holds the times of all episodes of the
    /// rollout, in any unit. Leave earlier episodes out of a decision
    /// ([`Frames::select`](crate::Frames::select)): both groups together would look like a third.
    ///
    /// All candidates' features are tested together for a change at any place that leaves
    /// `min_episodes` on either side ([`change_test`]), at the level `doubt`, with the permutations
    /// of a second look. Only the latest episodes are tested, as many as a second look takes.
    /// [`Rule::Fixed`] has no tests and never finds a changepoint.
    ///
    /// # Errors
    /// A number of episodes that differs from the length of `began`, or clouds that cannot be
    /// compared.
    pub fn cut<R: Rng + ?Sized>(
        &self,
        candidates: &[Candidate],
        began: &[usize],
        rng: &mut R,
    ) -> Result<Option<usize>> {
        for candidate in candidates {
            let (expected, got) = (candidate.rollout.episodes(), began.len());
            within("began", got as f64, got == expected, "a time for each episode")?;
        }
        let Rule::Calibrated(settings) = &self.settings.rule else {
            return Ok(None);
        };
        let size = settings.second_look();
        let mut order: Vec<usize> = (0..began.len()).collect();
        order.sort_by_key(|&episode| began[episode]);
        let latest = &order[order.len().saturating_sub(size.rollout)..];
        let times: Vec<_> = latest.iter().map(|&episode| began[episode]).collect();
        let places = change_places(&times, settings.min_episodes);
        if places.is_empty() || candidates.is_empty() {
            return Ok(None);
        }
        let sources = candidates.iter().map(|c| c.rollout.select(latest));
        let sources = sources.collect::<Result<Vec<_>>>()?;
        let test = change_test(&sources, &places, size.permutations, rng)?;
        Ok((test.p_value <= settings.doubt).then_some(times[test.cut]))
    }

    /// Rejects rollouts that are too small for the rule's error rates.
    fn check_rollouts(&self, candidates: &[Candidate]) -> Result<()> {
        let Rule::Calibrated(settings) = &self.settings.rule else {
            return Ok(());
        };
        let needed = settings.min_episodes;
        let mut sizes = candidates.iter().map(|c| c.rollout.episodes());
        match sizes.find(|&episodes| episodes < needed) {
            Some(episodes) => Err(ClusterError::RolloutTooSmall { episodes, needed }),
            None => Ok(()),
        }
    }

    fn look<R: Rng + ?Sized>(
        &self,
        look: Look,
        candidates: &[Candidate],
        rng: &mut R,
    ) -> Result<Assignment> {
        for (index, candidate) in candidates.iter().enumerate() {
            candidate.check(index)?;
        }
        let judge = |candidate| match &self.settings.rule {
            Rule::Fixed { threshold } => judge_fixed(candidate, *threshold),
            Rule::Calibrated(settings) => judge_calibrated(candidate, settings, look, rng),
        };
        let evidence = candidates.iter().map(judge).collect::<Result<Vec<_>>>()?;
        let decision = decide(&evidence);
        Ok(Assignment { decision, evidence })
    }
}

fn distance(candidate: &Candidate) -> Result<f64> {
    let (o, b) = (&candidate.rollout, &candidate.buffer);
    wasserstein1(o.features(), b.features(), o.dim())
}

fn judge_fixed(candidate: &Candidate, limit: f64) -> Result<Evidence> {
    let distance = distance(candidate)?;
    let verdict = if distance <= limit { Verdict::Accepted } else { Verdict::Rejected };
    Ok(Evidence { distance, judgement: Judgement::Threshold { limit }, verdict })
}

fn judge_calibrated<R: Rng + ?Sized>(
    candidate: &Candidate,
    settings: &Calibrated,
    look: Look,
    rng: &mut R,
) -> Result<Evidence> {
    let needed = settings.min_episodes;
    let episodes = candidate.buffer.episodes();
    if episodes < needed {
        return Ok(Evidence {
            distance: distance(candidate)?,
            judgement: Judgement::BufferTooSmall { episodes, needed },
            verdict: Verdict::Accepted,
        });
    }
    let size = match look {
        Look::First => settings.first_look(),
        Look::Second => settings.second_look(),
    };
    let test = permutation_test(candidate, size, rng)?;
    Ok(weigh(test, settings, look))
}

/// Compares a test with the level of its look.
fn weigh(test: PermutationTest, settings: &Calibrated, look: Look) -> Evidence {
    let (limit, verdict) = match look {
        Look::First if test.p_value <= settings.doubt => (settings.doubt, Verdict::Doubted),
        Look::First => (settings.doubt, Verdict::Accepted),
        // this level is finer than the number of splits resolves, hence the fitted tail; and a
        // significant difference may still be drift, hence the ratio
        Look::Second => (settings.level, settle(&test, settings)),
    };
    Evidence { distance: test.distance, judgement: Judgement::Tested { test, limit }, verdict }
}

fn settle(test: &PermutationTest, settings: &Calibrated) -> Verdict {
    if test.tail_p_value <= settings.level && test.ratio() >= settings.min_ratio {
        Verdict::Rejected
    } else {
        Verdict::Accepted
    }
}

fn decide(evidence: &[Evidence]) -> Decision {
    let accepted = |e: &Evidence| e.verdict == Verdict::Accepted;
    let doubted = evidence.iter().any(|e| e.verdict == Verdict::Doubted);
    match best(evidence, accepted) {
        Some(index) => Decision::Existing(index),
        None if doubted => Decision::Undecided,
        None => Decision::New,
    }
}

/// Returns the index of the best candidate among the `eligible` ones; the first of equals.
fn best(evidence: &[Evidence], eligible: impl Fn(&Evidence) -> bool) -> Option<usize> {
    let eligible = evidence.iter().enumerate().filter(|(_, e)| eligible(e));
    let best = eligible.min_by(|(_, a), (_, b)| {
        let ((a_last, a), (b_last, b)) = (a.rank(), b.rank());
        a_last.cmp(&b_last).then(a.total_cmp(&b))
    });
    best.map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::permutation::NullDistribution;

    fn test(p_value: f64, tail_p_value: f64, distance: f64) -> PermutationTest {
        let null = NullDistribution {
            permutations: 100,
            mean: 1.0,
            sd: 1.0,
            skewness: 0.0,
            q05: 1.0,
            q50: 1.0,
            q95: 1.0,
            max: 1.0,
        };
        PermutationTest { distance, null, score: distance - 1.0, p_value, tail_p_value }
    }

    #[test]
    fn each_look_compares_its_own_p_value_with_its_own_level() {
        use Verdict::{Accepted, Doubted, Rejected};
        let settings = Calibrated::default();
        let cases = [
            (Look::First, 0.021, 0.0, 9.0, Accepted),
            (Look::First, 0.02, 1.0, 0.5, Doubted),
            (Look::Second, 0.0, 1.1e-4, 9.0, Accepted),
            (Look::Second, 1.0, 1e-4, 1.1, Rejected),
            (Look::Second, 0.0, 1e-9, 1.09, Accepted),
        ];
        for (look, p_value, tail, distance, verdict) in cases {
            let evidence = weigh(test(p_value, tail, distance), &settings, look);
            assert_eq!(evidence.verdict, verdict, "{look:?} {p_value} {tail} {distance}");
        }
    }

    #[test]
    fn the_lowest_score_wins_and_untested_candidates_come_last() {
        let settings = Calibrated::default();
        let tested = |p, distance| weigh(test(p, 0.0, distance), &settings, Look::First);
        let small = |distance| Evidence {
            distance,
            judgement: Judgement::BufferTooSmall { episodes: 1, needed: 8 },
            verdict: Verdict::Accepted,
        };
        let (near, far, doubted) = (tested(0.5, 1.0), tested(0.1, 3.0), tested(0.01, 0.1));
        let cases = [
            (vec![far, near, near], Decision::Existing(1)),
            (vec![small(0.1), far], Decision::Existing(1)),
            (vec![small(2.0), doubted, small(1.0)], Decision::Existing(2)),
            (vec![doubted, far], Decision::Existing(1)),
            (vec![doubted], Decision::Undecided),
            (vec![], Decision::New),
        ];
        for (evidence, decision) in cases {
            assert_eq!(decide(&evidence), decision, "{evidence:?}");
        }
        let other_cases = [
            (vec![small(0.1), far, doubted, near], Some([2, 3])),
            (vec![near, small(0.1), near], Some([0, 2])),
            (vec![small(0.1), near], None),
            (vec![], None),
        ];
        for (evidence, rivals) in other_cases {
            let decision = decide(&evidence);
            let assignment = Assignment { decision, evidence };
            assert_eq!(assignment.rivals(), rivals, "{assignment:?}");
        }
    }
}

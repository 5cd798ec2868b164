//! Test of one policy: the sources of evidence and the result of their joint permutation test.

use cluster::{
    AlternativeHypothesis, EvidenceSourceSamples, EvidenceSourceTestResult, FrameFeatures,
    JointPermutationTestResult, PolicyEvidence, PolicyVerdict, RolloutAndBufferFeatures,
};

use crate::error::Result;
use crate::summary::EpisodeSummary;

/// Number of standard deviations that a change of motion by 100 % counts as in the outlier score of
/// a policy.
const MOTION_WEIGHT: f64 = 10.0;

/// Source of evidence: the quantity of an episode that is compared between two sets of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EvidenceSource {
    Image,
    Vector,
    Motion,
    RewardGradient,
    Return,
}

impl EvidenceSource {
    /// Sources of evidence that do not depend on actions: first image and first vector.
    pub(crate) const FIRST_OBSERVATION: &'static [Self] = &[Self::Image, Self::Vector];
    /// All sources of evidence.
    pub(crate) const ALL: &'static [Self] =
        &[Self::Image, Self::Vector, Self::Motion, Self::RewardGradient, Self::Return];

    /// Returns `true` for sources that do not depend on actions: first image and first vector.
    pub(crate) fn is_first_observation(self) -> bool {
        Self::FIRST_OBSERVATION.contains(&self)
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Vector => "vector",
            Self::Motion => "motion",
            Self::RewardGradient => "reward gradient",
            Self::Return => "return",
        }
    }

    pub(crate) fn point(self, summary: &EpisodeSummary) -> Option<&[f32]> {
        match self {
            Self::Image => Some(&summary.image_features),
            Self::Vector => Some(&summary.first_vector),
            Self::Motion => summary.motion.as_deref(),
            Self::RewardGradient => summary.reward_gradient.as_deref(),
            Self::Return => summary.episode_return.as_ref().map(std::slice::from_ref),
        }
    }
}

/// Stage of the test of a policy: screening by one rollout, or the final confirmation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TestStage {
    /// Test of one rollout, which is not final: a doubt asks for another rollout.
    Screening,
    /// Final test of two rollouts, or of one that the tested policy collected itself.
    Confirmation,
}

/// Relation of a tested policy to the tested episodes, such as being the policy that acted in them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PolicyRole {
    /// Policy that did not act in the tested episodes.
    Other,
    /// Policy that acted and continues the task that it trained on last.
    Collector,
    /// Policy that acted after a time without training: its task group may have drifted meanwhile.
    Returning,
    /// Policy that acted although images or vectors rejected it: its returns must show that it
    /// serves the task group, as far as they rose in training.
    Provisional,
}

/// Result of testing whether episodes belong to the task group of one policy.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyTestResult {
    /// Verdict on the policy, after all sources of evidence were tested.
    pub verdict: PolicyVerdict,
    /// Joint test of all sources of evidence; `None` if the policy remembers too few episodes.
    pub test: Option<JointPermutationTestResult>,
    /// Sources of evidence of the joint test, in the order of its results.
    pub(crate) sources: &'static [EvidenceSource],
    /// Relative change of motion (response of the observation vector to actions) from the
    /// remembered to the tested episodes; 0 if it is unknown.
    pub motion_change: f64,
    /// Relative change of the reward gradient from the remembered to the tested episodes.
    pub(crate) gradient_change: f64,
    /// Share of the policy's gain in return that is missing in the tested episodes.
    pub(crate) return_loss: f64,
    /// Standard error of `return_loss`.
    pub(crate) return_loss_error: f64,
    /// Rise of the policy's return since its first rollout, in standard deviations of the return.
    pub(crate) gain: f64,
    /// Rise of the return of the tested episodes over the policy's first rollout, in standard
    /// deviations of the return.
    pub(crate) episode_gain: f64,
    pub(crate) role: PolicyRole,
}

impl PolicyTestResult {
    /// Converts the test result to the type [`PolicyEvidence`] of the crate `cluster`, with the
    /// distance of the first source that was tested.
    pub fn evidence(&self) -> PolicyEvidence {
        PolicyEvidence {
            distance: self.source_tests().next().map_or(0.0, |(_, test)| test.distance),
            test: self.test.as_ref().map(|test| test.overall),
            verdict: self.verdict,
        }
    }

    /// Returns the smallest p-value of all sources of evidence by the fitted Pearson tail, adjusted
    /// for the number of sources; 1 if nothing was tested.
    pub fn tail_p_value(&self) -> f64 {
        self.test.as_ref().map_or(1.0, |test| test.overall.tail_p_value)
    }

    /// Returns the exact p-value of all sources of evidence together; 1 if nothing was tested.
    pub(crate) fn p_value(&self) -> f64 {
        self.test.as_ref().map_or(1.0, |test| test.overall.p_value)
    }

    pub(crate) fn is_rejected(&self) -> bool {
        self.verdict == PolicyVerdict::Rejected
    }

    /// Returns the tests of first image and first vector.
    fn first_observation(&self) -> impl Iterator<Item = &EvidenceSourceTestResult> {
        let all = self.source_tests();
        all.filter(|(source, _)| source.is_first_observation()).map(|(_, test)| test)
    }

    /// Returns the larger of the standardised distances of first images and of first vectors;
    /// infinity for a policy that was not tested, so that it ranks last.
    pub(crate) fn first_observation_score(&self) -> f64 {
        if self.test.is_none() {
            return f64::INFINITY;
        }
        self.first_observation().map(|test| test.score).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the larger of two ratios, those of the distance of first images and of first vectors
    /// to its mean over random splits; 0 if neither was tested.
    pub(crate) fn first_observation_ratio(&self) -> f64 {
        self.first_observation().map(EvidenceSourceTestResult::distance_ratio).fold(0.0, f64::max)
    }

    /// Returns the outlier score, by which policies are ranked: larger the worse the policy fits.
    /// It is that of images and vectors, and for policies that they do not separate also of motion,
    /// which hardly depends on the acting policy.
    pub(crate) fn outlier_score(&self) -> f64 {
        self.first_observation_score() + MOTION_WEIGHT * self.motion_change
    }

    /// Returns `true` if first images or vectors differ from the remembered ones at the
    /// significance level `level`.
    pub(crate) fn first_observation_differs(&self, level: f64) -> bool {
        self.first_observation().any(|test| differs(test, level))
    }

    /// Returns the smaller of the p-values of first images and of first vectors, by the fitted
    /// tail; 1 if neither was tested.
    pub(crate) fn first_observation_p_value(&self) -> f64 {
        self.first_observation().map(|test| test.tail_p_value).fold(1.0, f64::min)
    }

    /// Returns each source of evidence with its test result; sources whose pooled points are all
    /// equal are left out.
    pub(crate) fn source_tests(
        &self,
    ) -> impl Iterator<Item = (EvidenceSource, &EvidenceSourceTestResult)> {
        let results = self.test.iter().flat_map(|joint| &joint.sources);
        let pairs = self.sources.iter().zip(results);
        pairs.filter_map(|(&source, test)| Some((source, test.as_ref()?)))
    }
}

/// Share of the significance level at which a p-value by the fitted tail is certain enough to end a
/// permutation test early.
pub(crate) const CERTAIN: f64 = 1e-3;

/// Returns `true` if the tested and the remembered episodes differ in one source of evidence at the
/// significance level `level`: by the exact p-value, or with certainty by the fitted tail, if the
/// test ended before exact p-values were fine enough.
pub(crate) fn differs(test: &EvidenceSourceTestResult, level: f64) -> bool {
    test.p_value <= level || test.tail_p_value <= CERTAIN * level
}

/// Returns the distance between the mean points of a source of evidence in two lists of episodes,
/// relative to the norm of the second mean; 0 if either is unknown.
pub(crate) fn relative_change(
    summaries: &[&EpisodeSummary],
    remembered: &[&EpisodeSummary],
    source: EvidenceSource,
) -> f64 {
    match (mean_point(summaries, source), mean_point(remembered, source)) {
        (Some(now), Some(before)) if now.len() == before.len() => {
            let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
            let change = norm(&mut now.iter().zip(&before).map(|(now, before)| now - before));
            (change / norm(&mut before.iter().copied()).max(f64::MIN_POSITIVE)).sqrt()
        }
        _ => 0.0,
    }
}

fn mean_point(summaries: &[&EpisodeSummary], source: EvidenceSource) -> Option<Vec<f64>> {
    let known: Vec<&[f32]> = summaries.iter().filter_map(|s| source.point(s)).collect();
    let mut mean = vec![0.0; known.first()?.len()];
    for point in &known {
        for (sum, &entry) in mean.iter_mut().zip(point.iter()) {
            *sum += f64::from(entry) / known.len() as f64;
        }
    }
    Some(mean)
}

/// Returns the mean return of the episodes whose return is known; `None` if there are none.
pub(crate) fn mean_return<'a>(summaries: impl Iterator<Item = &'a EpisodeSummary>) -> Option<f64> {
    let returns: Vec<f64> = summaries.filter_map(|s| s.episode_return.map(f64::from)).collect();
    (!returns.is_empty()).then(|| returns.iter().sum::<f64>() / returns.len() as f64)
}

/// Returns the summaries of episodes recorded to their end, since all sources need the same
/// episodes; `None` if these are fewer than `least` or than half of all.
pub(crate) fn whole_episodes<'a>(
    summaries: &[&'a EpisodeSummary],
    least: usize,
) -> Option<Vec<&'a EpisodeSummary>> {
    let is_whole = |s: &&&EpisodeSummary| s.motion.is_some() && s.episode_return.is_some();
    let whole: Vec<&EpisodeSummary> = summaries.iter().filter(is_whole).copied().collect();
    (whole.len() >= least && 2 * whole.len() >= summaries.len()).then_some(whole)
}

/// Returns the points of one source of evidence as [`FrameFeatures`], one frame for each episode.
pub(crate) fn frames(
    summaries: &[&EpisodeSummary],
    source: EvidenceSource,
) -> Result<FrameFeatures> {
    let points: Vec<&[f32]> = summaries.iter().filter_map(|s| source.point(s)).collect();
    let dim = points.first().map_or(0, |point| point.len());
    Ok(FrameFeatures::new(points.concat(), 1, dim)?)
}

/// Largest distance between first vectors that count as equal, in the unit of their components.
// Vectors that are constant in each variant differ beyond doubt, however little: an arm starts a
// millimetre off on one side of the table, which is 0.01 here.
const EQUAL_VECTORS: f64 = 0.02;

/// Returns `true` if the first vectors of all episodes count as equal.
fn have_equal_vectors<'a>(mut episodes: impl Iterator<Item = &'a EpisodeSummary>) -> bool {
    let Some(first) = episodes.next() else { return true };
    episodes.all(|episode| {
        let pairs = episode.first_vector.iter().zip(&first.first_vector);
        let square: f64 = pairs.map(|(&a, &b)| f64::from(a - b).powi(2)).sum();
        // other lengths are refused where points are compared
        episode.first_vector.len() == first.first_vector.len() && square <= EQUAL_VECTORS.powi(2)
    })
}

/// Returns for each source of evidence the points of the rollout's episodes and those of the
/// remembered ones. Vectors that count as equal are the same point.
pub(crate) fn samples(
    sources: &[EvidenceSource],
    rollout: &[&EpisodeSummary],
    remembered: &[&EpisodeSummary],
) -> Result<Vec<EvidenceSourceSamples>> {
    let has_equal_vectors = have_equal_vectors(rollout.iter().chain(remembered).copied());
    let samples = |&source: &EvidenceSource| {
        let points = |summaries: &[&EpisodeSummary]| match source {
            EvidenceSource::Vector if has_equal_vectors => {
                Ok(FrameFeatures::new(vec![0.0; summaries.len()], 1, 1)?)
            }
            _ => frames(summaries, source),
        };
        let (rollout, buffer) = (points(rollout)?, points(remembered)?);
        // a policy whose returns exceed the remembered ones serves the group all the same
        let is_return = source == EvidenceSource::Return;
        let alternative =
            if is_return { AlternativeHypothesis::Less } else { AlternativeHypothesis::TwoSided };
        Ok(EvidenceSourceSamples {
            clouds: RolloutAndBufferFeatures { buffer, rollout },
            alternative,
        })
    };
    sources.iter().map(samples).collect()
}

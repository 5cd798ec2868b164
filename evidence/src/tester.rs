//! Test of new episodes against the memory of one policy.

use cluster::{
    EvidenceSourceTestResult, JointPermutationTestResult, PolicyVerdict, joint_permutation_test,
};
use rand_chacha::ChaCha8Rng;

use crate::error::Result;
use crate::memory::PolicyMemory;
use crate::policy_test::{
    CERTAIN, EvidenceSource, PolicyRole, PolicyTestResult, TestStage, differs, relative_change,
    samples, whole_episodes,
};
use crate::settings::RecogniserSettings;
use crate::summary::EpisodeSummary;

/// Number of random splits, including the observed one, that must reach the observed score to end a
/// permutation test early.
// Stopping insignificant tests does not raise the rate of false alarms (Besag and Clifford, 1991).
const REACHING: f64 = 8.0;

/// Increase of the significance level of returns, as a multiple of it, for a policy that lost its
/// whole gain in return.
const MAX_LEVEL_INCREASE: f64 = 30.0;
/// Least rise of a policy's return since its first rollout that counts as a gain, in standard
/// deviations of the return.
const MIN_GAIN: f64 = 1.0;
/// Least rise of a policy's return by which returns prove that the policy serves a task group, in
/// standard deviations of the return.
const PROVEN_GAIN: f64 = 3.0;
/// Largest loss of a policy that is proven by its returns, as a share of `min_loss`: a tenth of its
/// gain in return with the default of 0.3.
const MAX_LOSS: f64 = 1.0 / 3.0;
/// Factor on `min_ratio - 1` for a policy that acts again after a time without training: drift may
/// have changed its task group meanwhile.
// With the default of 1.2 the limit is 1.5: within it lie 19 of 20 groups whose colours drifted by
// a tenth of their range, and one of 100 other groups (docs/assignment_figures.md).
const DRIFT_FACTOR: f64 = 2.5;
/// Factor on `min_ratio - 1` for a policy that is far nearer than all others: the limit is 1.8 with
/// the default of 1.2.
const ISOLATED_DRIFT_FACTOR: f64 = 4.0;
/// Least ratio of the distance of motion to its mean over random splits: motion changes in
/// training, too.
// Ordinary networks that begin to learn Plate Slide reach 2.1, and groups with other dynamics 6.7
// and more (drawn worlds 1000 to 1007).
const LEAST_MOTION_RATIO: f64 = 3.0;
/// Least ratio of the distance of the reward gradient to its mean over random splits.
const LEAST_GRADIENT_RATIO: f64 = 2.0;
/// Least ratio of both if returns are not lower, since the policy may be learning then, which
/// changes how it acts. Policies that learn fast reach 2.4 (drawn worlds 1000 to 1007).
const LEAST_RATIO_WHILE_LEARNING: f64 = 4.0;

/// Tester of policies by permutation tests, with the settings of the recogniser.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PolicyTester<'a>(pub(crate) &'a RecogniserSettings);

impl PolicyTester<'_> {
    /// Tests the episodes `summaries` against those that one policy remembers; `role` says how the
    /// policy relates to the tested episodes.
    pub(crate) fn test(
        self,
        memory: &PolicyMemory,
        summaries: &[&EpisodeSummary],
        role: PolicyRole,
        stage: TestStage,
        rng: &mut ChaCha8Rng,
    ) -> Result<PolicyTestResult> {
        let least = self.0.min_episodes;
        let remembered: Vec<&EpisodeSummary> = memory.summaries.iter().collect();
        // motion and returns depend on who acts, so they count only if this policy acted
        let whole = whole_episodes(summaries, least).zip(whole_episodes(&memory.recent(), least));
        let (sources, seen, known) = match whole.filter(|_| role != PolicyRole::Other) {
            Some((seen, known)) => (EvidenceSource::ALL, seen, known),
            None => (EvidenceSource::FIRST_OBSERVATION, summaries.to_vec(), remembered.clone()),
        };
        // a merged policy is rejected unless it acted itself
        let is_out = memory.is_merged() && role == PolicyRole::Other;
        let mut result = PolicyTestResult {
            verdict: if is_out { PolicyVerdict::Rejected } else { PolicyVerdict::Accepted },
            test: None,
            sources,
            motion_change: relative_change(summaries, &remembered, EvidenceSource::Motion),
            gradient_change: relative_change(
                summaries,
                &remembered,
                EvidenceSource::RewardGradient,
            ),
            return_loss: memory.return_loss(summaries),
            return_loss_error: memory.return_loss_error(summaries),
            gain: memory.gain(),
            episode_gain: memory.gain_in(summaries),
            role,
        };
        // screening cannot change a rejection; confirmation ranks rejected policies by distance
        if remembered.len() < least || (is_out && stage == TestStage::Screening) {
            return Ok(result);
        }
        let all = self.0.permutations;
        let splits = [all / 4, all / 2, all, 3 * all];
        let splits = if stage == TestStage::Screening { &splits[..3] } else { &splits[..] };
        let decided = |test: &JointPermutationTestResult| {
            result.test = Some(test.clone());
            self.is_decided(&result, stage)
        };
        let test = joint_permutation_test(&samples(sources, &seen, &known)?, splits, decided, rng)?;
        result.test = Some(test);
        if !is_out {
            result.verdict = self.verdict(&result, stage);
        }
        Ok(result)
    }

    /// Returns `true` if more random splits would not change the outcome of a test: enough of them
    /// reach the largest score, or a difference that counts is far more significant than the level
    /// requires.
    fn is_decided(self, result: &PolicyTestResult, stage: TestStage) -> bool {
        let reaching =
            result.test.as_ref().map_or(0.0, |JointPermutationTestResult { overall, .. }| {
                overall.p_value * (1 + overall.null.permutations) as f64
            });
        let limit = CERTAIN * self.level(stage);
        let is_certain = |(source, test): (EvidenceSource, &EvidenceSourceTestResult)| {
            test.tail_p_value <= limit && self.counts(result, stage, source, test)
        };
        // `reaching` is a whole number but for rounding, hence the half
        reaching > REACHING - 0.5 || result.source_tests().any(is_certain)
    }

    fn level(self, stage: TestStage) -> f64 {
        match stage {
            TestStage::Screening => self.0.doubt,
            TestStage::Confirmation => self.0.level,
        }
    }

    /// Returns the verdict on a policy after a finished test. Screening uses exact p-values, and
    /// confirmation those of the fitted tail, because its level is finer than the number of splits
    /// resolves.
    fn verdict(self, result: &PolicyTestResult, stage: TestStage) -> PolicyVerdict {
        let level = self.level(stage);
        let mut different = result.source_tests().filter(|&(source, test)| match stage {
            TestStage::Screening => differs(test, level),
            TestStage::Confirmation => {
                test.tail_p_value <= level * self.level_factor(result, source)
            }
        });
        let is_against = different.any(|(source, test)| self.counts(result, stage, source, test))
            || (result.role == PolicyRole::Provisional && !self.may_keep_return(result));
        match (is_against, stage) {
            (false, _) => PolicyVerdict::Accepted,
            (true, TestStage::Screening) => PolicyVerdict::Doubted,
            (true, TestStage::Confirmation) => PolicyVerdict::Rejected,
        }
    }

    /// Returns `true` if a significant difference of one source counts against a policy. It must be
    /// large, except for images and vectors in screening, which only asks for more data.
    fn counts(
        self,
        result: &PolicyTestResult,
        stage: TestStage,
        source: EvidenceSource,
        test: &EvidenceSourceTestResult,
    ) -> bool {
        (stage == TestStage::Screening && source.is_first_observation())
            || self.exceeds_drift(result, source, test)
    }

    /// Returns the least distance ratio at which images and vectors reject a policy. It is larger
    /// for a policy that returns and proves by its returns that it serves the group, or has gained
    /// too little to prove anything.
    pub(crate) fn least_ratio(self, result: &PolicyTestResult) -> f64 {
        let has_returns = result.sources.contains(&EvidenceSource::Return);
        let cannot_prove = has_returns && result.gain < PROVEN_GAIN;
        let may_serve = self.is_proven(result) || cannot_prove;
        match result.role {
            PolicyRole::Returning if may_serve => self.max_drift(),
            PolicyRole::Provisional if may_serve => self.max_isolated_drift(),
            _ => self.0.min_ratio,
        }
    }

    /// Returns the largest ratio of a distance to its mean over random splits that counts as drift
    /// of the task group of a policy that was away.
    pub(crate) fn max_drift(self) -> f64 {
        1.0 + DRIFT_FACTOR * (self.0.min_ratio - 1.0)
    }

    /// Returns the largest ratio of a distance to its mean over random splits that counts as drift
    /// if all other policies are far more distant.
    pub(crate) fn max_isolated_drift(self) -> f64 {
        1.0 + ISOLATED_DRIFT_FACTOR * (self.0.min_ratio - 1.0)
    }

    /// Returns the factor on the significance level of a source: for returns it rises from 1 to 31
    /// with the lost share of the gain, for other sources it is 1.
    fn level_factor(self, result: &PolicyTestResult, source: EvidenceSource) -> f64 {
        let least = self.0.min_loss;
        let share = (result.return_loss - least) / (1.0 - least).max(f64::MIN_POSITIVE);
        match source {
            EvidenceSource::Return => 1.0 + MAX_LEVEL_INCREASE * share.clamp(0.0, 1.0),
            _ => 1.0,
        }
    }

    /// Returns `true` if the returns of the tested episodes prove that the policy serves their task
    /// group as well as its own.
    pub(crate) fn is_proven(self, result: &PolicyTestResult) -> bool {
        self.keeps_return(result) && result.episode_gain >= PROVEN_GAIN
    }

    /// Returns `true` if the returns of the tested episodes are known and about as high as those of
    /// the episodes that the policy remembers.
    pub(crate) fn keeps_return(self, result: &PolicyTestResult) -> bool {
        result.sources.contains(&EvidenceSource::Return) && !self.is_loss(result.return_loss)
    }

    /// Returns `true` if the returns of the tested episodes may be as high as those of the
    /// remembered ones, within one standard error. A policy whose images or vectors differ must
    /// pass this check: that a few episodes of its own do not reject it again proves nothing.
    fn may_keep_return(self, result: &PolicyTestResult) -> bool {
        result.sources.contains(&EvidenceSource::Return)
            && !self.is_loss(result.return_loss - result.return_loss_error)
    }

    /// Returns `true` if a policy that loses the share `return_loss` of its gain in return no
    /// longer serves the task group.
    pub(crate) fn is_loss(self, return_loss: f64) -> bool {
        return_loss > MAX_LOSS * self.0.min_loss
    }

    /// Returns `true` if a policy's `gain` is so large that a loss would show in its returns.
    pub(crate) fn has_proven_gain(self, gain: f64) -> bool {
        gain >= PROVEN_GAIN
    }

    /// Returns `true` if a policy with this `gain` has learnt something that its returns could
    /// lose in another task group.
    pub(crate) fn has_gain(self, gain: f64) -> bool {
        gain >= MIN_GAIN
    }

    /// Returns `true` if a difference is larger than drift or training explains, whatever its
    /// significance.
    fn exceeds_drift(
        self,
        result: &PolicyTestResult,
        source: EvidenceSource,
        test: &EvidenceSourceTestResult,
    ) -> bool {
        let is_large = |least| test.distance_ratio() >= self.least_training_ratio(result, least);
        match source {
            EvidenceSource::Image | EvidenceSource::Vector => {
                test.distance_ratio() >= self.least_ratio(result)
            }
            EvidenceSource::Motion => {
                let has_turned = result.motion_change >= self.0.min_motion;
                has_turned && is_large(LEAST_MOTION_RATIO)
            }
            // a policy with a proven gain is judged by its returns instead
            EvidenceSource::RewardGradient => {
                let has_turned = result.gradient_change >= self.0.min_motion;
                result.gain < PROVEN_GAIN && has_turned && is_large(LEAST_GRADIENT_RATIO)
            }
            EvidenceSource::Return => {
                self.has_gain(result.gain) && result.return_loss >= self.0.min_loss
            }
        }
    }

    /// Returns the least distance ratio at which motion or reward gradient counts: `usual`, or more
    /// if the returns of the tested episodes are not lower than the remembered ones. The policy may
    /// be learning then, which changes how it acts.
    fn least_training_ratio(self, result: &PolicyTestResult, usual: f64) -> f64 {
        let mut returns = result.source_tests().filter(|(s, _)| *s == EvidenceSource::Return);
        // the test is one-sided and adjusted by the maxima of all sources: returns that are not
        // lower have a distance of zero, far below these maxima, and a p-value near 1
        let not_lower = returns.any(|(_, test)| test.tail_p_value >= 1.0 - self.0.doubt);
        if not_lower { LEAST_RATIO_WHILE_LEARNING } else { usual }
    }

    /// Returns `true` if a test is significant enough to reject a policy after one rollout.
    pub(crate) fn rejects_surely(self, result: &PolicyTestResult) -> bool {
        self.rejecting_sources(result, CERTAIN * self.0.level).next().is_some()
    }

    /// Returns the sources of evidence in which tested and remembered episodes differ by more than
    /// drift explains, significantly at the level `level`.
    pub(crate) fn rejecting_sources(
        self,
        result: &PolicyTestResult,
        level: f64,
    ) -> impl Iterator<Item = EvidenceSource> {
        let significant = result.source_tests().filter(move |(_, test)| test.tail_p_value <= level);
        let large = significant.filter(move |&(s, test)| self.exceeds_drift(result, s, test));
        large.map(|(source, _)| source)
    }
}

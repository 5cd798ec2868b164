//! Joint permutation test of several sources of evidence.

use std::ops::RangeInclusive;

use rand::Rng;
use rand::seq::SliceRandom;

use crate::check::check_positive;
use crate::error::{ClusterError, Result};
use crate::euclidean::EuclideanDistances;
use crate::frames::RolloutAndBufferFeatures;
use crate::permutation::{NullDistribution, PermutationTestResult, ROUNDING};
use crate::transport::{PointWeights, TransportSolver};

/// Samples of one source of evidence: its points for the episodes of a rollout and of a buffer, and
/// the direction of the differences that count.
#[derive(Clone, Debug, PartialEq)]
pub struct EvidenceSourceSamples {
    /// Points of the rollout's and of the buffer's episodes.
    pub clouds: RolloutAndBufferFeatures,
    /// Direction in which a difference counts against the buffer's group, as in a one-sided or
    /// two-sided test.
    pub alternative: AlternativeHypothesis,
}

/// Alternative hypothesis of a test: rollout and buffer differ in any direction, or only so that
/// the rollout has the smaller mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlternativeHypothesis {
    /// Differences between rollout and buffer in any direction.
    TwoSided,
    /// Only differences in which the rollout has the smaller mean value over all dimensions;
    /// otherwise the distance is zero.
    Less,
}

/// Test result of one source of evidence in a [`JointPermutationTestResult`]. All values are
/// finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvidenceSourceTestResult {
    /// 1-Wasserstein distance between rollout and buffer in the source's own unit; zero if the
    /// difference has the direction that does not count.
    pub distance: f64,
    /// Mean of the distance over random splits of the pooled episodes.
    pub mean: f64,
    /// Standardised distance `(distance - mean) / sd`, with moments over random splits.
    pub score: f64,
    /// Share of splits, including the observed one, whose largest score over all sources is at
    /// least this source's score: its p-value, adjusted for the number of sources.
    pub p_value: f64,
    /// Adjusted p-value by the Pearson type III distribution with the moments of the largest
    /// scores.
    pub tail_p_value: f64,
}

impl EvidenceSourceTestResult {
    /// Returns the ratio of the observed distance to the mean distance over random splits.
    pub fn distance_ratio(&self) -> f64 {
        self.distance / self.mean.max(f64::MIN_POSITIVE)
    }
}

/// Result of a permutation test of the hypothesis that a rollout and a buffer have the same
/// distribution, over all sources of evidence together.
///
/// Whole episodes are permuted, in all sources alike, so the largest standardised distance has a
/// null distribution that takes the sources' dependence and their number into account: the "max T"
/// of Westfall and Young, "Resampling-based multiple testing" (1993), algorithm 2.8.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPermutationTestResult {
    /// Result of each source; `None` for one whose pooled points are all equal.
    pub sources: Vec<Option<EvidenceSourceTestResult>>,
    /// Largest score over all sources of evidence, and the smallest p-values of a source, at most
    /// 1.
    pub overall: PermutationTestResult,
}

/// Runs a joint permutation test of all sources of evidence in stages, until `is_decided` returns
/// `true` for the result so far or the last stage is complete. `stages` are total numbers of random
/// splits, ascending.
///
/// If `is_decided` only stops tests that are not going to be significant, as Besag and Clifford do
/// in "Sequential Monte Carlo p-values", Biometrika 78 (1991), false alarms become no more
/// frequent: each of them is also one of the complete test.
///
/// # Errors
/// No stage or one without a split, no source, sources that show different numbers of episodes, or
/// clouds that cannot be compared.
pub fn joint_permutation_test(
    sources: &[EvidenceSourceSamples],
    stages: &[usize],
    mut is_decided: impl FnMut(&JointPermutationTestResult) -> bool,
    rng: &mut impl Rng,
) -> Result<JointPermutationTestResult> {
    check_positive("splits", stages.iter().copied().min().unwrap_or(1))?;
    let mut counts = Vec::with_capacity(sources.len());
    for EvidenceSourceSamples { clouds: RolloutAndBufferFeatures { rollout, buffer }, .. } in
        sources
    {
        rollout.check_alike(buffer)?;
        counts.push((rollout.num_episodes(), buffer.num_episodes()));
    }
    let (rollout, buffer) = check_episode_counts(&counts)?;
    let mut pools = sources.iter().map(PooledSource::new).collect::<Result<Vec<_>>>()?;
    let mut order: Vec<usize> = (0..rollout + buffer).collect();
    measure(&mut pools, &order)?;
    let mut splits = 0;
    for (index, &stage) in stages.iter().enumerate() {
        for _ in splits..stage {
            order.shuffle(rng);
            measure(&mut pools, &order)?;
        }
        splits = splits.max(stage);
        let test = summarise(&pools, splits);
        if index + 1 == stages.len() || is_decided(&test) {
            return Ok(test);
        }
    }
    Err(ClusterError::Empty { what: "stages" })
}

/// Computes the distances of all sources under the same split of the episodes.
fn measure(pools: &mut [Option<PooledSource>], order: &[usize]) -> Result<()> {
    let mut pools = pools.iter_mut().flatten();
    pools.try_for_each(|pool| pool.measure(order))
}

/// Returns the numbers of episodes (rollout, buffer) of the first source, after checking that all
/// sources have the same.
pub(crate) fn check_episode_counts(counts: &[(usize, usize)]) -> Result<(usize, usize)> {
    let expected = *counts.first().ok_or(ClusterError::Empty { what: "sources" })?;
    match counts.iter().position(|&got| got != expected) {
        None => Ok(expected),
        Some(source_index) => {
            let got = counts[source_index];
            Err(ClusterError::SourceMismatch { source_index, got, expected })
        }
    }
}

/// Pooled points of one source, and its distances: first that of the observed split, then those of
/// random splits.
struct PooledSource {
    /// Distances between all pooled frames, `[frames, frames]`, and the largest of them.
    all: Vec<f64>,
    largest: f64,
    frames_per_episode: usize,
    /// Number of episodes on the first side of a split.
    split: usize,
    /// Sum of the values of each episode under [`AlternativeHypothesis::Less`]; `None` under
    /// [`AlternativeHypothesis::TwoSided`].
    sums: Option<Vec<f64>>,
    measured: Vec<f64>,
    /// Cost matrix of the transport problem of one split.
    costs: Vec<f64>,
    solver: TransportSolver,
}

impl PooledSource {
    /// Pools the features of all episodes of a source; `None` if all points are equal.
    fn new(source: &EvidenceSourceSamples) -> Result<Option<Self>> {
        let RolloutAndBufferFeatures { rollout, buffer } = &source.clouds;
        let features = [rollout.features(), buffer.features()].concat();
        let all = EuclideanDistances::new().compute(&features, &features, rollout.dim())?.to_vec();
        let largest = all.iter().copied().fold(0.0, f64::max);
        let frames_per_episode = rollout.frames_per_episode();
        let sum = |episode: &[f32]| episode.iter().map(|&v| f64::from(v)).sum::<f64>();
        let episodes = features.chunks(frames_per_episode * rollout.dim());
        Ok((largest > 0.0).then(|| Self {
            all,
            largest,
            frames_per_episode,
            split: rollout.num_episodes(),
            sums: (source.alternative == AlternativeHypothesis::Less)
                .then(|| episodes.map(sum).collect()),
            measured: Vec::new(),
            costs: Vec::new(),
            solver: TransportSolver::new(),
        }))
    }

    /// Appends the distance between the two sides of a split, which `order` lists one after the
    /// other.
    fn measure(&mut self, order: &[usize]) -> Result<()> {
        let (left, right) = order.split_at(self.split);
        let distance = if self.counts(left, right) { self.distance(left, right)? } else { 0.0 };
        self.measured.push(distance);
        Ok(())
    }

    /// Returns `true` if the difference between two lists of episodes has the direction that
    /// counts.
    fn counts(&self, left: &[usize], right: &[usize]) -> bool {
        self.sums.as_ref().is_none_or(|sums| {
            let mean =
                |part: &[usize]| part.iter().map(|&e| sums[e]).sum::<f64>() / part.len() as f64;
            mean(left) < mean(right)
        })
    }

    /// Returns the 1-Wasserstein distance between two lists of episodes.
    fn distance(&mut self, left: &[usize], right: &[usize]) -> Result<f64> {
        // the solver is fastest with more sources than sinks
        let (sources, sinks) = if left.len() < right.len() { (right, left) } else { (left, right) };
        let (k, frames) = (self.frames_per_episode, self.all.len().isqrt());
        self.costs.clear();
        for frame in sources.iter().flat_map(|episode| episode * k..(episode + 1) * k) {
            let row = &self.all[frame * frames..][..frames];
            for episode in sinks {
                self.costs.extend_from_slice(&row[episode * k..(episode + 1) * k]);
            }
        }
        let [a, b] = [sources, sinks].map(|side| PointWeights::Uniform(side.len() * k));
        Ok(self.solver.solve(&self.costs, a, b)?.cost)
    }

    /// Returns mean and standard deviation of the distances from index `from` on; the deviation is
    /// at least the rounding error.
    fn moments(&self, from: usize) -> (f64, f64) {
        let values = &self.measured[from..];
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        let sd = (variance / (values.len() as f64 - 1.0).max(1.0)).sqrt();
        (mean, sd.max(ROUNDING * self.largest))
    }

    fn scores(&self, from: usize) -> Vec<f64> {
        let (mean, sd) = self.moments(from);
        self.measured.iter().map(|d| (d - mean) / sd).collect()
    }
}

/// Largest difference of standardised distances that count as equal.
const EQUAL: f64 = 1e-9;

/// Returns the largest score over all sources for every split in `splits`; 0 if no source has a
/// result.
fn maxima(scores: &[Option<Vec<f64>>], splits: RangeInclusive<usize>) -> Vec<f64> {
    let largest = |split: usize| {
        let scores = scores.iter().flatten().map(|scores| scores[split]);
        scores.reduce(f64::max).unwrap_or(0.0)
    };
    splits.map(largest).collect()
}

fn summarise(pools: &[Option<PooledSource>], permutations: usize) -> JointPermutationTestResult {
    let scores = |from: usize| -> Vec<Option<Vec<f64>>> {
        pools.iter().map(|pool| Some(pool.as_ref()?.scores(from))).collect()
    };
    // with moments over all splits, including the observed one, the test is exact; the tail is
    // wider, since the observed split does not count in it
    let (exact, outer) = (scores(0), scores(1));
    let reached = maxima(&exact, 0..=permutations);
    let null = NullDistribution::new(maxima(&outer, 1..=permutations));
    let outcome_of = |index: usize| {
        let (pool, exact) = (pools[index].as_ref()?, exact[index].as_ref()?[0]);
        let score = outer[index].as_ref()?[0];
        let reaching = reached.iter().filter(|&&m| m >= exact - EQUAL).count();
        Some(EvidenceSourceTestResult {
            distance: pool.measured[0],
            mean: pool.moments(1).0,
            score,
            p_value: reaching as f64 / (1 + permutations) as f64,
            tail_p_value: null.tail(null.standardise(score)),
        })
    };
    let sources: Vec<_> = (0..pools.len()).map(outcome_of).collect();
    let smallest = |p_value: fn(&EvidenceSourceTestResult) -> f64| {
        sources.iter().flatten().map(p_value).fold(1.0, f64::min)
    };
    let overall = PermutationTestResult {
        null,
        score: null.standardise(maxima(&outer, 0..=0)[0]),
        p_value: smallest(|source| source.p_value),
        tail_p_value: smallest(|source| source.tail_p_value),
    };
    JointPermutationTestResult { sources, overall }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::draw;
    use crate::frames::FrameFeatures;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn source(
        rollout: &[f32],
        buffer: &[f32],
        alternative: AlternativeHypothesis,
    ) -> EvidenceSourceSamples {
        let frames = |values: &[f32]| FrameFeatures::new(values.to_vec(), 1, 1).unwrap();
        let clouds = RolloutAndBufferFeatures { rollout: frames(rollout), buffer: frames(buffer) };
        EvidenceSourceSamples { clouds, alternative }
    }

    fn whole(
        sources: &[EvidenceSourceSamples],
        splits: usize,
        rng: &mut ChaCha8Rng,
    ) -> Result<JointPermutationTestResult> {
        joint_permutation_test(sources, &[splits], |_| false, rng)
    }

    #[test]
    fn a_single_split_has_finite_moments() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let (near, far) = (draw(10, 0.0, &mut rng), draw(20, 3.0, &mut rng));
        let moved = source(&near, &far, AlternativeHypothesis::TwoSided);
        let test = whole(std::slice::from_ref(&moved), 1, &mut rng).unwrap();
        assert_eq!(test.overall.null.sd, 0.0);
        assert_eq!(test.overall.score, 0.0, "one split proves nothing");
        assert!(test.overall.tail_p_value > 0.1, "{}", test.overall.tail_p_value);
    }

    #[test]
    fn equal_points_say_nothing_and_do_not_silence_the_others() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let (near, far) = (draw(10, 0.0, &mut rng), draw(20, 3.0, &mut rng));
        let still = source(&[7.0; 10], &[7.0; 20], AlternativeHypothesis::TwoSided);
        let alone = whole(std::slice::from_ref(&still), 50, &mut rng).unwrap();
        assert_eq!((alone.sources[0], alone.overall.p_value), (None, 1.0));
        assert!(alone.overall.score.is_finite());
        let both = [still, source(&near, &far, AlternativeHypothesis::TwoSided)];
        let test = whole(&both, 50, &mut rng).unwrap();
        assert!(test.sources[0].is_none() && test.overall.p_value <= 1.0 / 51.0);
        assert!(test.sources[1].unwrap().distance_ratio() > 3.0);
    }

    #[test]
    fn a_one_sided_test_sees_only_its_alternative() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (low, high) = (draw(10, 0.0, &mut rng), draw(20, 3.0, &mut rng));
        let mut p = |rollout: &[f32], buffer: &[f32]| {
            let source = [source(rollout, buffer, AlternativeHypothesis::Less)];
            whole(&source, 99, &mut rng).unwrap().overall.p_value
        };
        assert!(p(&low, &high) <= 0.01);
        assert!(p(&high, &low) > 0.3);
    }

    /// 400 tests of ten sources, none of which differs: the rate of false alarms stays that of one.
    #[test]
    fn many_sources_give_no_more_false_alarms_than_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let alarms = (0..400).filter(|_| {
            let sources: Vec<EvidenceSourceSamples> = (0..10)
                .map(|_| {
                    source(
                        &draw(6, 0.0, &mut rng),
                        &draw(12, 0.0, &mut rng),
                        AlternativeHypothesis::TwoSided,
                    )
                })
                .collect();
            whole(&sources, 39, &mut rng).unwrap().overall.p_value <= 0.05
        });
        let alarms = alarms.count();
        // nominal 20; four standard deviations are 17
        assert!((5..=37).contains(&alarms), "{alarms}");
    }

    /// Stages draw what the whole test draws. Of 1000 tests in which nothing differs and that end
    /// once nine splits reach the distance at hand, no more are false alarms.
    #[test]
    fn early_ends_give_no_more_false_alarms() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let reaching = |test: &JointPermutationTestResult| {
            test.overall.p_value * (1 + test.overall.null.permutations) as f64
        };
        let (mut alarms, mut splits) = (0, 0);
        for _ in 0..1000 {
            let sources = [
                source(
                    &draw(6, 0.0, &mut rng),
                    &draw(12, 0.0, &mut rng),
                    AlternativeHypothesis::TwoSided,
                ),
                source(
                    &draw(6, 0.0, &mut rng),
                    &draw(12, 0.0, &mut rng),
                    AlternativeHypothesis::Less,
                ),
            ];
            let mut again = rng.clone();
            let decided = |test: &JointPermutationTestResult| reaching(test) > 8.5;
            let test = joint_permutation_test(&sources, &[19, 39, 79], decided, &mut rng).unwrap();
            let permutations = test.overall.null.permutations;
            assert_eq!(test, whole(&sources, permutations, &mut again).unwrap());
            alarms += usize::from(test.overall.p_value <= 0.05);
            splits += permutations;
        }
        // nominal 50; four standard deviations are 28
        assert!((22..=78).contains(&alarms), "{alarms}");
        assert!(splits < 50_000, "{splits} of 79,000");
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let sources = [
            source(&[0.0, 1.0], &[2.0], AlternativeHypothesis::TwoSided),
            source(&[0.0], &[2.0], AlternativeHypothesis::TwoSided),
        ];
        let message = whole(&sources, 20, &mut rng).unwrap_err().to_string();
        assert!(message.contains("source 1 shows (1, 1) episodes, expected (2, 1)"), "{message}");
        assert!(whole(&[], 20, &mut rng).is_err());
        assert!(whole(&sources[..1], 0, &mut rng).is_err());
        assert!(joint_permutation_test(&sources[..1], &[], |_| true, &mut rng).is_err());
    }
}

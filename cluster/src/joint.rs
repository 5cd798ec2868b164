//! Joint permutation test of several sources of evidence.

use std::ops::RangeInclusive;

use rand::Rng;
use rand::seq::SliceRandom;

use crate::check::positive;
use crate::error::{ClusterError, Result};
use crate::frames::{Candidate, Frames};
use crate::permutation::{NullDistribution, PooledDistances, ROUNDING, describe, tail};

/// Source of evidence: its points for the episodes of a rollout and of a buffer.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Points of the rollout's and of the buffer's episodes.
    pub clouds: Candidate,
    /// Direction in which a difference counts against the buffer's group.
    pub side: Side,
}

/// Direction of differences between rollout and buffer that count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Differences in any direction.
    Both,
    /// Only a rollout with a smaller mean value over all dimensions; otherwise the distance is
    /// zero.
    Less,
}

/// Result of one source in a [`JointTest`]. All values are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceTest {
    /// 1-Wasserstein distance between rollout and buffer in the source's own unit; zero on the side
    /// that does not count.
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

impl SourceTest {
    /// Returns the distance in units of its mean over random splits.
    pub fn ratio(&self) -> f64 {
        self.distance / self.mean.max(f64::MIN_POSITIVE)
    }
}

/// Result of a test of the hypothesis that a rollout and a buffer have one distribution, over all
/// sources of features together.
///
/// Whole episodes are permuted, in all sources alike, so the largest standardised distance has a
/// null distribution that takes the sources' dependence and their number into account: the "max T"
/// of Westfall and Young, "Resampling-based multiple testing" (1993), algorithm 2.8.
#[derive(Clone, Debug, PartialEq)]
pub struct JointTest {
    /// Result of each source; `None` for one whose pooled points are all equal.
    pub sources: Vec<Option<SourceTest>>,
    /// Distribution of the largest score over the sources, under random splits.
    pub null: NullDistribution,
    /// Largest score of the observed split, standardised by `null`.
    pub score: f64,
    /// Smallest p-value of a source, at most 1. Exact: for exchangeable episodes it is at most
    /// `a` with probability at most `a`, whatever the sources and their number.
    pub p_value: f64,
}

/// Runs a joint test of all sources with `permutations` random splits.
///
/// # Errors
/// No split, no source, sources that show different numbers of episodes, or clouds that cannot be
/// compared.
pub fn joint_test<R: Rng + ?Sized>(
    sources: &[Source],
    permutations: usize,
    rng: &mut R,
) -> Result<JointTest> {
    joint_test_until(sources, &[permutations], |_| false, rng)
}

/// Runs a joint test of all sources in stages until an outcome is `decided`. `stages` are total
/// numbers of random splits, ascending; the last stage ends the test in any case.
///
/// If `decided` only stops tests that are not going to be significant, as Besag and
/// Clifford do in "Sequential Monte Carlo p-values", Biometrika 78 (1991), false alarms become no
/// more frequent: each of them is also one of the complete test.
///
/// # Errors
/// Errors of [`joint_test`], and an empty list of stages.
pub fn joint_test_until<R: Rng + ?Sized>(
    sources: &[Source],
    stages: &[usize],
    decided: impl Fn(&JointTest) -> bool,
    rng: &mut R,
) -> Result<JointTest> {
    positive("splits", stages.iter().copied().min().unwrap_or(1))?;
    let (rollout, buffer) = episodes(sources)?;
    let pools = sources.iter().map(|source| {
        let Candidate { rollout: o, buffer: b } = &source.clouds;
        let features = [o.features(), b.features()].concat();
        Pool::new(&features, o, source.side, rollout)
    });
    let mut pools = pools.collect::<Result<Vec<_>>>()?;
    let mut order: Vec<usize> = (0..rollout + buffer).collect();
    measure(&mut pools, &order)?;
    let mut splits = 0;
    for (index, &stage) in stages.iter().enumerate() {
        for _ in splits..stage {
            order.shuffle(rng);
            measure(&mut pools, &order)?;
        }
        splits = splits.max(stage);
        let test = judge(&pools, splits);
        if index + 1 == stages.len() || decided(&test) {
            return Ok(test);
        }
    }
    Err(ClusterError::Empty { what: "stages" })
}

/// Measures all pools under the same split.
fn measure(pools: &mut [Option<Pool>], order: &[usize]) -> Result<()> {
    let mut pools = pools.iter_mut().flatten();
    pools.try_for_each(|pool| pool.measure(order))
}

/// Returns the numbers of episodes on both sides, which all sources must share.
fn episodes(sources: &[Source]) -> Result<(usize, usize)> {
    let mut clouds = sources.iter().map(|source| &source.clouds).enumerate();
    clouds.try_for_each(|(index, clouds)| clouds.check(index))?;
    shared(sources.iter().map(|source| {
        let Candidate { rollout, buffer } = &source.clouds;
        (rollout.episodes(), buffer.episodes())
    }))
}

/// Returns the numbers of episodes of the first source, after checking that all sources share them.
pub(crate) fn shared(
    counts: impl Iterator<Item = (usize, usize)> + Clone,
) -> Result<(usize, usize)> {
    let first = counts.clone().next();
    let expected = first.ok_or(ClusterError::Empty { what: "sources" })?;
    match counts.enumerate().find(|(_, got)| *got != expected) {
        None => Ok(expected),
        Some((source_index, got)) => {
            Err(ClusterError::SourceMismatch { source_index, got, expected })
        }
    }
}

/// Distances of one source: first that of the observed split, then those of random splits.
struct Pool {
    distances: PooledDistances,
    /// Number of episodes of the first side.
    split: usize,
    /// Sum of the values of each episode under [`Side::Less`]; `None` under [`Side::Both`].
    sums: Option<Vec<f64>>,
    measured: Vec<f64>,
}

impl Pool {
    /// Pools the features of all episodes, with the sizes of `like`; `None` if all points are
    /// equal.
    fn new(features: &[f32], like: &Frames, side: Side, split: usize) -> Result<Option<Self>> {
        let distances = PooledDistances::new(features, like)?;
        let each = like.frames_per_episode() * like.dim();
        let sum = |episode: &[f32]| episode.iter().map(|&v| f64::from(v)).sum::<f64>();
        Ok((distances.largest() > 0.0).then(|| Self {
            distances,
            split,
            sums: (side == Side::Less).then(|| features.chunks(each).map(sum).collect()),
            measured: Vec::new(),
        }))
    }

    /// Appends the distance between the two sides of the episodes in this order.
    fn measure(&mut self, order: &[usize]) -> Result<()> {
        let distance =
            if self.counts(order) { self.distances.between(order, self.split)? } else { 0.0 };
        self.measured.push(distance);
        Ok(())
    }

    /// Returns `true` if the difference between the two sides counts.
    fn counts(&self, order: &[usize]) -> bool {
        let (first, second) = order.split_at(self.split);
        self.sums.as_ref().is_none_or(|sums| {
            let mean =
                |side: &[usize]| side.iter().map(|&e| sums[e]).sum::<f64>() / side.len() as f64;
            mean(first) < mean(second)
        })
    }

    /// Returns mean and standard deviation of the distances from this index on; the deviation is at
    /// least the rounding error.
    fn moments(&self, from: usize) -> (f64, f64) {
        let values = &self.measured[from..];
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        let sd = (variance / (values.len() as f64 - 1.0).max(1.0)).sqrt();
        (mean, sd.max(ROUNDING * self.distances.largest()))
    }

    fn scores(&self, from: usize) -> Vec<f64> {
        let (mean, sd) = self.moments(from);
        self.measured.iter().map(|d| (d - mean) / sd).collect()
    }
}

/// Largest difference of scores that count as equal.
const EQUAL: f64 = 1e-9;

/// Returns the scores of every source with a result, with moments of its distances from index
/// `from` on.
fn scores(pools: &[Option<Pool>], from: usize) -> Vec<Option<Vec<f64>>> {
    let pools = pools.iter().map(Option::as_ref);
    pools.map(|pool| Some(pool?.scores(from))).collect()
}

/// Returns the largest score of every split over all sources; 0 if no source has a result.
fn maxima(scores: &[Option<Vec<f64>>], splits: RangeInclusive<usize>) -> Vec<f64> {
    let largest = |split: usize| {
        let scores = scores.iter().flatten().map(|scores| scores[split]);
        scores.reduce(f64::max).unwrap_or(0.0)
    };
    splits.map(largest).collect()
}

fn judge(pools: &[Option<Pool>], permutations: usize) -> JointTest {
    // with moments over all splits, including the observed one, the test is exact; the tail is
    // wider, since the observed split does not count in it
    let (exact, outer) = (scores(pools, 0), scores(pools, 1));
    let reached = maxima(&exact, 0..=permutations);
    let null = describe(maxima(&outer, 1..=permutations), ROUNDING);
    let standardised = |score: f64| (score - null.mean) / null.sd.max(ROUNDING);
    let outcome_of = |index: usize| {
        let (pool, exact) = (pools[index].as_ref()?, exact[index].as_ref()?[0]);
        let score = outer[index].as_ref()?[0];
        let reaching = reached.iter().filter(|&&m| m >= exact - EQUAL).count();
        Some(SourceTest {
            distance: pool.measured[0],
            mean: pool.moments(1).0,
            score,
            p_value: reaching as f64 / (1 + permutations) as f64,
            tail_p_value: tail(standardised(score), &null),
        })
    };
    let sources: Vec<_> = (0..pools.len()).map(outcome_of).collect();
    let p_values = sources.iter().flatten().map(|source| source.p_value);
    JointTest {
        p_value: p_values.fold(1.0, f64::min),
        score: standardised(maxima(&outer, 0..=0)[0]),
        sources,
        null,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::draw;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn source(rollout: &[f32], buffer: &[f32], side: Side) -> Source {
        let frames = |values: &[f32]| Frames::new(values.to_vec(), 1, 1).unwrap();
        let clouds = Candidate { rollout: frames(rollout), buffer: frames(buffer) };
        Source { clouds, side }
    }

    #[test]
    fn equal_points_say_nothing_and_do_not_silence_the_others() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let (near, far) = (draw(10, 0.0, &mut rng), draw(20, 3.0, &mut rng));
        let still = source(&[7.0; 10], &[7.0; 20], Side::Both);
        let alone = joint_test(std::slice::from_ref(&still), 50, &mut rng).unwrap();
        assert_eq!((alone.sources[0], alone.p_value), (None, 1.0));
        assert!(alone.score.is_finite());
        let both = [still, source(&near, &far, Side::Both)];
        let test = joint_test(&both, 50, &mut rng).unwrap();
        assert!(test.sources[0].is_none() && test.p_value <= 1.0 / 51.0);
        assert!(test.sources[1].unwrap().ratio() > 3.0);
    }

    #[test]
    fn only_the_side_that_counts_is_seen() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (low, high) = (draw(10, 0.0, &mut rng), draw(20, 3.0, &mut rng));
        let mut p = |rollout: &[f32], buffer: &[f32]| {
            let source = [source(rollout, buffer, Side::Less)];
            joint_test(&source, 99, &mut rng).unwrap().p_value
        };
        assert!(p(&low, &high) <= 0.01);
        assert!(p(&high, &low) > 0.3);
    }

    /// 400 tests of ten sources, none of which differs: the rate of false alarms stays that of one.
    #[test]
    fn many_sources_give_no_more_false_alarms_than_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let alarms = (0..400).filter(|_| {
            let sources: Vec<Source> = (0..10)
                .map(|_| source(&draw(6, 0.0, &mut rng), &draw(12, 0.0, &mut rng), Side::Both))
                .collect();
            joint_test(&sources, 39, &mut rng).unwrap().p_value <= 0.05
        });
        let alarms = alarms.count();
        // nominal 20; four standard deviations are 17
        assert!((5..=37).contains(&alarms), "{alarms}");
    }

    /// The stages of one test draw what the whole test draws, and the last one decides.
    #[test]
    fn a_test_that_is_never_decided_is_the_whole_test() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let sources = [source(&draw(8, 0.3, &mut rng), &draw(9, 0.0, &mut rng), Side::Both)];
        let run = |stages: &[usize], splits: usize| {
            let mut split_rng = ChaCha8Rng::seed_from_u64(7);
            let decided = |test: &JointTest| test.null.permutations >= splits;
            joint_test_until(&sources, stages, decided, &mut split_rng).unwrap()
        };
        let whole = joint_test(&sources, 60, &mut ChaCha8Rng::seed_from_u64(7)).unwrap();
        assert_eq!(run(&[10, 30, 60], 100), whole);
        assert_eq!(run(&[10, 30, 60], 20).null.permutations, 30);
        let mut other_rng = ChaCha8Rng::seed_from_u64(7);
        assert!(joint_test_until(&sources, &[], |_| true, &mut other_rng).is_err());
        assert!(joint_test(&sources, 0, &mut other_rng).is_err());
    }

    /// Tests that stop once nine splits reach the distance at hand: 1000 tests in which nothing
    /// differs, and the rate of false alarms stays below the level.
    #[test]
    fn early_ends_give_no_more_false_alarms() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let reaching = |test: &JointTest| test.p_value * (1 + test.null.permutations) as f64;
        let (mut alarms, mut splits) = (0, 0);
        for _ in 0..1000 {
            let sources = [
                source(&draw(6, 0.0, &mut rng), &draw(12, 0.0, &mut rng), Side::Both),
                source(&draw(6, 0.0, &mut rng), &draw(12, 0.0, &mut rng), Side::Less),
            ];
            let decided = |test: &JointTest| reaching(test) > 8.5;
            let test = joint_test_until(&sources, &[19, 39, 79], decided, &mut rng).unwrap();
            alarms += usize::from(test.p_value <= 0.05);
            splits += test.null.permutations;
        }
        // nominal 50; four standard deviations are 28
        assert!((22..=78).contains(&alarms), "{alarms}");
        assert!(splits < 50_000, "{splits} of 79,000");
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let sources = [source(&[0.0, 1.0], &[2.0], Side::Both), source(&[0.0], &[2.0], Side::Both)];
        let message = joint_test(&sources, 20, &mut rng).unwrap_err().to_string();
        assert!(message.contains("source 1 shows (1, 1) episodes, expected (2, 1)"), "{message}");
        assert!(joint_test(&[], 20, &mut rng).is_err());
    }
}

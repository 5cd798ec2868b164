//! Distribution of 1-Wasserstein distances over random splits of pooled episodes.

use crate::error::Result;
use crate::euclidean::EuclideanCosts;
use crate::frames::Frames;
use crate::tail::pearson3_tail;
use crate::transport::{Solver, Weights};

/// Rounding allowance for distances, as a fraction of the largest pooled one.
pub(crate) const ROUNDING: f64 = 1e-9;

/// Distribution of a distance, or of a joint test's largest score, over random splits of the pooled
/// episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NullDistribution {
    /// Number of random splits of the pooled episodes.
    pub permutations: usize,
    /// Mean of the distance or score over random splits.
    pub mean: f64,
    /// Standard deviation of the distance or score over random splits.
    pub sd: f64,
    /// Skewness over random splits, the third standardised moment; distances are skewed to the
    /// right.
    pub skewness: f64,
    /// 5 % quantile of the distance or score over random splits.
    pub q05: f64,
    /// Median of the distance or score over random splits.
    pub q50: f64,
    /// 95 % quantile of the distance or score over random splits.
    pub q95: f64,
    /// Largest distance or score of a random split.
    pub max: f64,
}

/// Result of a permutation test. All values are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PermutationTest {
    /// 1-Wasserstein distance between the episodes of the rollout and those of the buffer that
    /// entered the test.
    pub distance: f64,
    /// Distribution of the distance if rollout and buffer were exchangeable.
    pub null: NullDistribution,
    /// Standardised distance `(distance - mean) / sd`; zero where all splits and the distance
    /// agree.
    pub score: f64,
    /// P-value `(1 + splits at least as far apart) / (1 + splits)`, in `(0, 1]`. Exact: for
    /// exchangeable episodes it is at most `a` with probability at most `a`, whatever the features.
    pub p_value: f64,
    /// P-value of the score under the Pearson type III distribution of the null's moments, in
    /// `[0, 1]`. It is an approximation, for levels that the number of splits does not resolve.
    pub tail_p_value: f64,
}

/// Distances between all pooled frames, and the memory for the part that one split needs.
pub(crate) struct PooledDistances {
    all: Vec<f64>,
    frames: usize,
    per_episode: usize,
    cost: Vec<f64>,
    solver: Solver,
}

impl PooledDistances {
    pub(crate) fn new(features: &[f32], like: &Frames) -> Result<Self> {
        let all = EuclideanCosts::new().compute(features, features, like.dim())?.to_vec();
        let frames = features.len() / like.dim();
        Ok(Self {
            all,
            frames,
            per_episode: like.frames_per_episode(),
            cost: Vec::new(),
            solver: Solver::new(),
        })
    }

    pub(crate) fn largest(&self) -> f64 {
        self.all.iter().copied().fold(0.0, f64::max)
    }

    /// Returns `W1` between the first `split` episodes of `order` and the rest.
    pub(crate) fn between(&mut self, order: &[usize], split: usize) -> Result<f64> {
        let k = self.per_episode;
        let (left, right) = order.split_at(split);
        // the solver is fastest with more sources than sinks
        let (sources, sinks) = if split < right.len() { (right, left) } else { (left, right) };
        self.cost.clear();
        for frame in sources.iter().flat_map(|episode| episode * k..(episode + 1) * k) {
            let row = &self.all[frame * self.frames..][..self.frames];
            for episode in sinks {
                self.cost.extend_from_slice(&row[episode * k..(episode + 1) * k]);
            }
        }
        let [a, b] = [sources, sinks].map(|side| Weights::Uniform(side.len() * k));
        Ok(self.solver.solve(&self.cost, a, b)?.cost)
    }
}

/// The probability of a score under the Pearson type III distribution of the null's moments.
pub(crate) fn tail(score: f64, null: &NullDistribution) -> f64 {
    let skewness = null.skewness.max(0.0) + skewness_error(null.permutations);
    pearson3_tail(score, skewness)
}

/// Standard error of the skewness of a normal sample. It is added to the skewness measured, since a
/// tail that is taken for too light costs a false alarm, and one that is taken for too heavy
/// little.
fn skewness_error(permutations: usize) -> f64 {
    (6.0 / permutations as f64).sqrt()
}

pub(crate) fn describe(mut splits: Vec<f64>, rounding: f64) -> NullDistribution {
    splits.sort_unstable_by(f64::total_cmp);
    let count = splits.len() as f64;
    let mean = splits.iter().sum::<f64>() / count;
    let sd = (splits.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
    let standardised = splits.iter().map(|w| (w - mean) / sd.max(rounding));
    let quantile = |share: f64| splits[(share * (count - 1.0)).round() as usize];
    NullDistribution {
        permutations: splits.len(),
        mean,
        sd,
        skewness: standardised.map(|z| z.powi(3)).sum::<f64>() / count,
        q05: quantile(0.05),
        q50: quantile(0.5),
        q95: quantile(0.95),
        max: quantile(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_null_distribution() {
        // 0, 1, ..., 100, in an order that is not sorted
        let null = describe((0..=100).map(|i| f64::from(i * 37 % 101)).collect(), 1e-9);
        assert_eq!((null.permutations, null.mean, null.max), (101, 50.0, 100.0));
        assert_eq!((null.q05, null.q50, null.q95), (5.0, 50.0, 95.0));
        assert!((null.sd - 858.5_f64.sqrt()).abs() < 1e-12 && null.skewness.abs() < 1e-12);
    }

    #[test]
    fn splits_that_are_equal_have_no_skewness() {
        let null = describe(vec![1.0; 20], 1e-9);
        assert_eq!((null.sd, null.skewness), (0.0, 0.0));
        assert!(tail(0.0, &null) > 0.1);
    }
}

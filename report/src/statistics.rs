//! Statistics over seeds: means and interquartile means with intervals by a bootstrap in two
//! levels, and performance profiles.
//!
//! Source of the statistics: Agarwal et al., "Deep Reinforcement Learning at the Edge of the
//! Statistical Precipice" (NeurIPS 2021). Their bootstrap draws seeds within each group; this one
//! draws whole runs, since one learner made the scores of all groups of a run, and then placements.

use std::collections::HashMap;

use experiments::evaluation::mean;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{Binomial, DiscreteCDF};

/// Number of bootstrap samples for a confidence interval; rliable's default.
const DRAWS: usize = 50_000;
/// Number of bootstrap samples for each point of a performance profile; rliable's default.
const PROFILE_DRAWS: usize = 2000;
/// Quantiles of the bootstrap samples that bound a 95 % confidence interval.
const BOUNDS: [f64; 2] = [0.025, 0.975];

/// Scores of one method, one for each task group and seed.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodScores {
    /// Scores `[groups][seeds]`; the scores of one run have the same place in every group.
    pub by_group: Vec<Vec<f64>>,
    /// Number of different placements that each score is the success rate of; `None` for scores
    /// that are not success rates.
    pub placements: Option<u64>,
}

/// Bounds of a confidence interval, 95 % unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfidenceInterval {
    /// Lower bound.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
}

/// Returns the interquartile mean: the mean without the lowest and the highest quarter of the
/// values, each rounded down, as scipy's `trim_mean` with 0.25. NaN for no values.
pub fn interquartile_mean(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let cut = sorted.len() / 4;
    mean(&sorted[cut..sorted.len() - cut])
}

/// Returns the median; NaN for no values.
pub fn median(values: &[f64]) -> f64 {
    quantile(values.to_vec(), 0.5)
}

/// Returns the quantile of values at `share` in `[0, 1]`, interpolated between neighbours as NumPy
/// does it; NaN for no values. Values may be infinite.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile_of_sorted(&values, share)
}

fn quantile_of_sorted(values: &[f64], share: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else {
        return f64::NAN;
    };
    let place = share * last as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    let (low, high) = (values[below], values[(below + 1).min(last)]);
    // the difference of two infinite neighbours would be NaN
    if part == 0.0 || low == high {
        return low;
    }
    low + part * (high - low)
}

impl MethodScores {
    /// Returns scores `[groups][seeds]` that are not success rates.
    pub fn new(by_group: Vec<Vec<f64>>) -> Self {
        Self { by_group, placements: None }
    }

    /// Returns a statistic of the scores of all groups and seeds together.
    pub fn pooled_statistic(&self, statistic: fn(&[f64]) -> f64) -> f64 {
        statistic(&self.by_group.concat())
    }

    /// Returns the number of seeds of the group with the fewest seeds.
    pub fn min_seed_count(&self) -> usize {
        self.by_group.iter().map(Vec::len).min().unwrap_or(0)
    }

    /// Returns the mean score of each run over all groups.
    pub fn run_means(&self) -> Vec<f64> {
        let of_run =
            |run: usize| mean(&self.by_group.iter().map(|own| own[run]).collect::<Vec<_>>());
        (0..self.min_seed_count()).map(of_run).collect()
    }

    /// Returns the 95 % interval of a statistic by the bootstrap. `None` for fewer than two seeds.
    pub fn bootstrap_interval(&self, statistic: fn(&[f64]) -> f64) -> Option<ConfidenceInterval> {
        (self.min_seed_count() > 1).then(|| {
            let mut bootstrap = Bootstrap::new(self);
            let draws = (0..DRAWS).map(|_| statistic(&bootstrap.draw()));
            percentiles(draws.collect())
        })
    }

    /// Returns the 95 % interval of this method's mean score minus the other's by the bootstrap.
    /// `None` for fewer than two seeds.
    pub fn mean_difference_interval(&self, other: &Self) -> Option<ConfidenceInterval> {
        let enough = self.min_seed_count().min(other.min_seed_count()) > 1;
        enough.then(|| {
            let (mut own, mut others) = (Bootstrap::new(self), Bootstrap::with_seed(other, 1));
            let mut difference = || mean(&own.draw()) - mean(&others.draw());
            percentiles((0..DRAWS).map(|_| difference()).collect())
        })
    }

    /// Returns the share of pairs of runs in which this method scores above the other in the same
    /// group, averaged over groups. Equal scores count one half.
    pub fn probability_of_improvement(&self, other: &Self) -> f64 {
        let groups = self.by_group.iter().zip(&other.by_group);
        let above = groups.map(|(ours, theirs)| {
            let pairs = ours.iter().flat_map(|a| theirs.iter().map(move |b| (a, b)));
            let worth = pairs.map(|(a, b)| {
                f64::midpoint(f64::from(u8::from(a > b)), f64::from(u8::from(a >= b)))
            });
            mean(&worth.collect::<Vec<_>>())
        });
        mean(&above.collect::<Vec<_>>())
    }

    /// Returns the performance profile: for each threshold the share of scores above it, with its
    /// pointwise 95 % interval by the bootstrap; no interval for fewer than two seeds, and no
    /// profile without scores.
    pub fn performance_profile(
        &self,
        thresholds: &[f64],
    ) -> Vec<(f64, Option<ConfidenceInterval>)> {
        let mut bootstrap = Bootstrap::new(self);
        let draws = if self.min_seed_count() > 1 { PROFILE_DRAWS } else { 0 };
        let draws: Vec<Vec<f64>> = (0..draws).map(|_| bootstrap.draw()).collect();
        let share = |scores: &[f64], threshold: f64| {
            scores.iter().filter(|score| **score > threshold).count() as f64 / scores.len() as f64
        };
        let own = self.by_group.concat();
        if own.is_empty() {
            return Vec::new();
        }
        let point = |&threshold: &f64| {
            let shares = draws.iter().map(|draw| share(draw, threshold));
            let interval = (!draws.is_empty()).then(|| percentiles(shares.collect()));
            (share(&own, threshold), interval)
        };
        thresholds.iter().map(point).collect()
    }
}

/// Bootstrap in two levels: draws whole runs with replacement, each with its scores of all groups,
/// and then the successes of each of these scores from as many placements.
struct Bootstrap<'a> {
    scores: &'a MethodScores,
    /// Cumulative probabilities of 0, 1, ... successes, by the bits of a success rate.
    successes: HashMap<u64, Vec<f64>>,
    rng: ChaCha8Rng,
}

impl<'a> Bootstrap<'a> {
    fn new(scores: &'a MethodScores) -> Self {
        Self::with_seed(scores, 0)
    }

    /// Creates a bootstrap with a fixed seed: the same runs give the same report.
    fn with_seed(scores: &'a MethodScores, seed: u64) -> Self {
        let mut successes = HashMap::new();
        for &rate in scores.by_group.iter().flatten() {
            // a rate of 0 stays 0, and scores that are not success rates have no second level
            if let Some(placements) = scores.placements
                && rate > 0.0
                && let Ok(binomial) = Binomial::new(rate, placements)
            {
                let cumulative = || (0..placements).map(|count| binomial.cdf(count)).collect();
                successes.entry(rate.to_bits()).or_insert_with(cumulative);
            }
        }
        Self { scores, successes, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Returns one bootstrap sample: the scores of all groups and seeds together.
    fn draw(&mut self) -> Vec<f64> {
        let seeds = self.scores.min_seed_count();
        let runs: Vec<usize> = (0..seeds).map(|_| self.rng.random_range(0..seeds)).collect();
        let mut sample = Vec::with_capacity(self.scores.by_group.len() * seeds);
        for own in &self.scores.by_group {
            let rates = runs.iter().map(|&run| own[run]);
            sample.extend(rates.map(|rate| drawn(&self.successes, rate, &mut self.rng)));
        }
        sample
    }
}

/// Returns the success rate of as many placements, drawn with replacement from those of `rate`.
fn drawn(successes: &HashMap<u64, Vec<f64>>, rate: f64, rng: &mut ChaCha8Rng) -> f64 {
    let Some(cumulative) = successes.get(&rate.to_bits()) else {
        return rate;
    };
    let uniform: f64 = rng.random();
    let count = cumulative.partition_point(|&probability| probability < uniform);
    count as f64 / cumulative.len() as f64
}

/// Returns the quantiles [`BOUNDS`] of bootstrap samples, interpolated between neighbours.
fn percentiles(mut values: Vec<f64>) -> ConfidenceInterval {
    values.sort_by(f64::total_cmp);
    let [low, high] = BOUNDS.map(|share| quantile_of_sorted(&values, share));
    ConfidenceInterval { low, high }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interquartile_mean_is_that_of_scipy() {
        // scipy.stats.trim_mean(v, 0.25)
        assert_eq!(interquartile_mean(&[5.0, 1.0, 2.0, 9.0]), 3.5);
        assert_eq!(interquartile_mean(&[5.0, 1.0, 2.0]), mean(&[5.0, 1.0, 2.0]));
        assert_eq!(interquartile_mean(&[7.0, 1.0, 0.0, 2.0, 3.0, 90.0, 4.0, 5.0, 6.0]), 4.0);
        assert!(interquartile_mean(&[]).is_nan());
    }

    #[test]
    fn percentiles_are_interpolated() {
        // numpy.percentile(range(101), [2.5, 97.5])
        let interval = percentiles((0..101).map(f64::from).rev().collect());
        assert_eq!((interval.low, interval.high), (2.5, 97.5));
    }

    #[test]
    fn quantiles_are_numpys_and_know_infinity() {
        // numpy.quantile([3, 1, 2, 10], [0.5, 0.9])
        assert_eq!(median(&[3.0, 1.0, 2.0, 10.0]), 2.5);
        assert!((quantile(vec![3.0, 1.0, 2.0, 10.0], 0.9) - 7.9).abs() < 1e-12);
        let never = f64::INFINITY;
        assert_eq!(median(&[1.0, never, 5.0]), 5.0);
        assert_eq!(median(&[1.0, never, never]), never);
        assert_eq!(median(&[1.0, 2.0, never, never]), never);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn the_interval_of_a_mean_is_as_wide_as_the_spread_of_the_runs() {
        let scores = MethodScores::new(vec![vec![0.0, 0.2, 0.4, 0.6]]);
        let interval = scores.bootstrap_interval(mean).unwrap();
        // the standard error of the mean is sqrt(0.05 / 4) = 0.112
        let expected = 1.96 * (0.05_f64 / 4.0).sqrt();
        assert!((interval.low - (0.3 - expected)).abs() < 0.02, "{interval:?}");
        assert!((interval.high - (0.3 + expected)).abs() < 0.02, "{interval:?}");
        assert_eq!(scores.bootstrap_interval(mean), scores.bootstrap_interval(mean));
    }

    /// Both runs succeed in 80 of 100 placements, so that placements alone vary.
    #[test]
    fn placements_are_drawn_within_runs() {
        let scores = MethodScores { by_group: vec![vec![0.8, 0.8]], placements: Some(100) };
        let interval = scores.bootstrap_interval(mean).unwrap();
        let expected = 1.96 * (0.8_f64 * 0.2 / 200.0).sqrt();
        assert!((interval.low - (0.8 - expected)).abs() < 0.01, "{interval:?}");
        assert!((interval.high - (0.8 + expected)).abs() < 0.01, "{interval:?}");
        let certain = MethodScores { by_group: vec![vec![1.0, 0.0]], placements: Some(100) };
        let of_certain = certain.bootstrap_interval(mean).unwrap();
        assert_eq!((of_certain.low, of_certain.high), (0.0, 1.0));
    }

    #[test]
    fn a_performance_profile_falls_from_all_scores_to_none() {
        let scores = MethodScores::new(vec![vec![0.2, 0.6], vec![1.0, 1.0]]);
        let profile = scores.performance_profile(&[0.0, 0.2, 0.6, 1.0]);
        let shares: Vec<f64> = profile.iter().map(|point| point.0).collect();
        assert_eq!(shares, [1.0, 0.75, 0.5, 0.0]);
        // one half to all of the scores are above 0.2
        let interval = profile[1].1.unwrap();
        assert_eq!((interval.low, interval.high), (0.5, 1.0));
        assert_eq!(MethodScores::new(vec![vec![0.5]]).performance_profile(&[0.0]), [(1.0, None)]);
    }

    #[test]
    fn one_seed_has_no_interval() {
        let (one, two) = (vec![vec![1.0]], vec![vec![1.0, 0.5]]);
        let (one, two) = (MethodScores::new(one), MethodScores::new(two));
        assert_eq!(one.bootstrap_interval(interquartile_mean), None);
        assert_eq!(two.mean_difference_interval(&one), None);
    }

    #[test]
    fn improvement_counts_pairs_and_halves_ties() {
        let one = MethodScores::new(vec![vec![1.0, 0.5], vec![0.0, 0.0]]);
        let other = MethodScores::new(vec![vec![0.5, 0.0], vec![0.0, 1.0]]);
        // group one: 1 above both, 0.5 equal and above: 3.5 of 4; group two: 2 halves of 4
        let share = one.probability_of_improvement(&other);
        assert_eq!(share, (3.5 / 4.0 + 1.0 / 4.0) / 2.0);
        assert_eq!(share + other.probability_of_improvement(&one), 1.0);
    }

    #[test]
    fn runs_that_fail_in_all_groups_are_drawn_whole() {
        // one of two seeds fails everywhere: the mean of two draws is 0 in a quarter of all cases
        let halves = MethodScores::new(vec![vec![0.0, 1.0]; 4]);
        let none = MethodScores::new(vec![vec![0.0, 0.0]; 4]);
        let interval = halves.mean_difference_interval(&none).unwrap();
        assert_eq!((interval.low, interval.high), (0.0, 1.0));
        assert_eq!(halves.bootstrap_interval(mean), Some(interval));
    }

    #[test]
    fn a_difference_that_is_always_there_does_not_reach_zero() {
        let one = MethodScores::new(vec![vec![0.9, 1.0, 0.95]]);
        let other = MethodScores::new(vec![vec![0.2, 0.4, 0.3]]);
        let interval = one.mean_difference_interval(&other).unwrap();
        assert!(interval.low > 0.5 && interval.high < 0.8, "{interval:?}");
        // two bootstraps of equal scores are independent of each other
        let against = one.mean_difference_interval(&one).unwrap();
        assert!(against.low < 0.0 && against.high > 0.0);
    }
}

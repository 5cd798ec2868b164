//! Statistics over seeds, as Agarwal et al. define them ("Deep Reinforcement Learning at the Edge
//! of the Statistical Precipice", NeurIPS 2021; their library is rliable).

use experiments::evaluation::mean;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of bootstrap samples for a confidence interval; rliable's default.
const DRAWS: usize = 50_000;
/// Number of bootstrap samples for each point of a performance profile; rliable's default.
const PROFILE_DRAWS: usize = 2000;
/// Quantiles of the bootstrap samples that bound a 95 % confidence interval.
const BOUNDS: [f64; 2] = [0.025, 0.975];

/// Scores of one method `[groups][seeds]`, one for each task group and seed.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodScores(pub Vec<Vec<f64>>);

/// Bounds of a 95 % confidence interval by bootstrap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BootstrapInterval {
    /// Lower bound: the 2.5th percentile of the bootstrap samples.
    pub low: f64,
    /// Upper bound: the 97.5th percentile of the bootstrap samples.
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
    /// Returns a statistic of the scores of all groups and seeds together.
    pub fn pooled_statistic(&self, statistic: fn(&[f64]) -> f64) -> f64 {
        statistic(&self.0.concat())
    }

    /// Returns the number of seeds of the group with the fewest seeds.
    pub fn min_seed_count(&self) -> usize {
        self.0.iter().map(Vec::len).min().unwrap_or(0)
    }

    /// Returns the 95 % interval of a statistic by the stratified bootstrap, which draws seeds with
    /// replacement within each group. `None` for fewer than two seeds.
    pub fn bootstrap_interval(&self, statistic: fn(&[f64]) -> f64) -> Option<BootstrapInterval> {
        self.resampled(|scores| scores.pooled_statistic(statistic))
    }

    /// Returns the 95 % interval of this method's mean score minus the other's. The bootstrap draws
    /// whole runs: one learner made the scores of all its groups, so they are not independent.
    /// `None` for fewer than two seeds.
    pub fn mean_difference_interval(&self, other: &Self) -> Option<BootstrapInterval> {
        pair_interval(self, other, |one, other| {
            one.pooled_statistic(mean) - other.pooled_statistic(mean)
        })
    }

    /// Returns the share of pairs of runs in which this method scores above the other in the same
    /// group, averaged over groups, and its 95 % interval by a bootstrap over whole runs. Equal
    /// scores count one half.
    pub fn probability_of_improvement(&self, other: &Self) -> (f64, Option<BootstrapInterval>) {
        let interval = pair_interval(self, other, probability);
        (probability(self, other), interval)
    }

    /// Returns the performance profile: for each threshold the share of scores above it, with its
    /// pointwise 95 % interval by the stratified bootstrap; no interval for fewer than two seeds.
    pub fn performance_profile(&self, thresholds: &[f64]) -> Vec<(f64, Option<BootstrapInterval>)> {
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let draws = if self.min_seed_count() > 1 { PROFILE_DRAWS } else { 0 };
        let draws: Vec<Vec<f64>> = (0..draws).map(|_| self.draw(rng).0.concat()).collect();
        let share = |scores: &[f64], threshold: f64| {
            scores.iter().filter(|score| **score > threshold).count() as f64 / scores.len() as f64
        };
        let own = self.0.concat();
        let point = |&threshold: &f64| {
            let shares = draws.iter().map(|draw| share(draw, threshold));
            let interval = (!draws.is_empty()).then(|| percentiles(shares.collect()));
            (share(&own, threshold), interval)
        };
        thresholds.iter().map(point).collect()
    }

    fn resampled(&self, statistic: impl Fn(&Self) -> f64) -> Option<BootstrapInterval> {
        // a fixed seed: the same runs give the same report
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let enough = self.min_seed_count() > 1;
        enough.then(|| percentiles((0..DRAWS).map(|_| statistic(&self.draw(rng))).collect()))
    }

    /// Returns one bootstrap sample: as many scores of each group, drawn with replacement.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Self {
        let draw = |scores: &Vec<f64>| -> Vec<f64> {
            scores.iter().map(|_| scores[rng.random_range(0..scores.len())]).collect()
        };
        Self(self.0.iter().map(draw).collect())
    }

    /// Returns one bootstrap sample of whole runs, each drawn with its scores of all groups.
    fn draw_runs(&self, rng: &mut ChaCha8Rng) -> Self {
        let seeds = self.min_seed_count();
        let drawn: Vec<usize> = (0..seeds).map(|_| rng.random_range(0..seeds)).collect();
        let of = |scores: &Vec<f64>| drawn.iter().map(|&seed| scores[seed]).collect();
        Self(self.0.iter().map(of).collect())
    }
}

fn pair_interval(
    one: &MethodScores,
    other: &MethodScores,
    statistic: fn(&MethodScores, &MethodScores) -> f64,
) -> Option<BootstrapInterval> {
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let enough = one.min_seed_count().min(other.min_seed_count()) > 1;
    let mut draw = |_| statistic(&one.draw_runs(rng), &other.draw_runs(rng));
    enough.then(|| percentiles((0..DRAWS).map(&mut draw).collect()))
}

fn probability(one: &MethodScores, other: &MethodScores) -> f64 {
    let groups = one.0.iter().zip(&other.0);
    let above = groups.map(|(ours, theirs)| {
        let pairs = ours.iter().flat_map(|a| theirs.iter().map(move |b| (a, b)));
        let worth = pairs
            .map(|(a, b)| f64::midpoint(f64::from(u8::from(a > b)), f64::from(u8::from(a >= b))));
        mean(&worth.collect::<Vec<_>>())
    });
    mean(&above.collect::<Vec<_>>())
}

/// Returns the quantiles [`BOUNDS`] of bootstrap samples, interpolated between neighbours.
fn percentiles(mut values: Vec<f64>) -> BootstrapInterval {
    values.sort_by(f64::total_cmp);
    let [low, high] = BOUNDS.map(|share| quantile_of_sorted(&values, share));
    BootstrapInterval { low, high }
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
    fn seeds_are_drawn_within_their_group() {
        // groups far apart: their difference is no part of the interval
        let scores = MethodScores(vec![vec![0.0, 0.2, 0.4, 0.6], vec![100.0, 100.0, 100.0, 100.0]]);
        let interval = scores.bootstrap_interval(mean).unwrap();
        // the standard error of the first group's mean is sqrt(0.05 / 4) = 0.112; half of it counts
        let expected = 1.96 * 0.5 * (0.05_f64 / 4.0).sqrt();
        let centre = scores.pooled_statistic(mean);
        assert!((interval.low - (centre - expected)).abs() < 0.01, "{interval:?}");
        assert!((interval.high - (centre + expected)).abs() < 0.01, "{interval:?}");
        assert_eq!(scores.bootstrap_interval(mean), scores.bootstrap_interval(mean));
    }

    #[test]
    fn a_performance_profile_falls_from_all_scores_to_none() {
        let scores = MethodScores(vec![vec![0.2, 0.6], vec![1.0, 1.0]]);
        let profile = scores.performance_profile(&[0.0, 0.2, 0.6, 1.0]);
        let shares: Vec<f64> = profile.iter().map(|point| point.0).collect();
        assert_eq!(shares, [1.0, 0.75, 0.5, 0.0]);
        // with seeds drawn within groups, one half to all of the scores are above 0.2
        let interval = profile[1].1.unwrap();
        assert_eq!((interval.low, interval.high), (0.5, 1.0));
        assert_eq!(MethodScores(vec![vec![0.5]]).performance_profile(&[0.0]), [(1.0, None)]);
    }

    #[test]
    fn one_seed_has_no_interval() {
        let (one, two) = (MethodScores(vec![vec![1.0]]), MethodScores(vec![vec![1.0, 0.5]]));
        assert_eq!(one.bootstrap_interval(interquartile_mean), None);
        assert_eq!(two.mean_difference_interval(&one), None);
        assert_eq!(two.probability_of_improvement(&one).1, None);
    }

    #[test]
    fn improvement_counts_pairs_and_halves_ties() {
        let one = MethodScores(vec![vec![1.0, 0.5], vec![0.0, 0.0]]);
        let other = MethodScores(vec![vec![0.5, 0.0], vec![0.0, 1.0]]);
        // group one: 1 above both, 0.5 equal and above: 3.5 of 4; group two: 2 halves of 4
        let (share, interval) = one.probability_of_improvement(&other);
        assert_eq!(share, (3.5 / 4.0 + 1.0 / 4.0) / 2.0);
        let (back, _) = other.probability_of_improvement(&one);
        assert_eq!(share + back, 1.0);
        let interval = interval.unwrap();
        assert!(interval.low < share && share < interval.high);
    }

    #[test]
    fn runs_that_fail_in_all_groups_are_drawn_whole_where_methods_are_compared() {
        // one of two seeds fails everywhere: the mean of two draws is 0 in a quarter of all cases
        let halves = MethodScores(vec![vec![0.0, 1.0]; 4]);
        let none = MethodScores(vec![vec![0.0, 0.0]; 4]);
        let interval = halves.mean_difference_interval(&none).unwrap();
        assert_eq!((interval.low, interval.high), (0.0, 1.0));
        // drawn within each group, as rliable has it, 8 draws rarely agree
        let grouped = halves.bootstrap_interval(mean).unwrap();
        assert!(grouped.low > 0.1 && grouped.high < 0.9, "{grouped:?}");
    }

    #[test]
    fn a_difference_that_is_always_there_does_not_reach_zero() {
        let one = MethodScores(vec![vec![0.9, 1.0, 0.95]]);
        let other = MethodScores(vec![vec![0.2, 0.4, 0.3]]);
        let interval = one.mean_difference_interval(&other).unwrap();
        assert!(interval.low > 0.5 && interval.high < 0.8, "{interval:?}");
        let against = one.mean_difference_interval(&one).unwrap();
        assert!(against.low < 0.0 && against.high > 0.0);
    }
}

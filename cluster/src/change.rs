//! Changepoint test: energy distances at all cuts of a sequence of episodes, in one permutation
//! test.

use rand::Rng;
use rand::seq::SliceRandom;

use crate::check::{check_positive, check_range};
use crate::error::{ClusterError, Result};
use crate::euclidean::EuclideanDistances;
use crate::frames::FrameFeatures;
use crate::joint::check_episode_counts;
use crate::permutation::ROUNDING;

/// Number of integer units that the largest distance between two episodes is rounded to.
// 20 bits of a distance and 20 of the number of pairs, so sums over a million pairs fit into the
// 53 bits of an `f64`'s significand.
const UNITS: f64 = (1_u32 << 20) as f64;
/// Largest difference of standardised distances that count as equal.
const EQUAL: f64 = 1e-9;

/// Most likely changepoint of a sequence of episodes, with the p-value of the hypothesis that
/// nothing changes.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangepointTestResult {
    /// Number of episodes before the most likely changepoint.
    pub changepoint: usize,
    /// Exact p-value of the hypothesis that nothing changes, over all candidate changepoints and
    /// sources together, as in a [`JointPermutationTestResult`](crate::JointPermutationTestResult).
    pub p_value: f64,
}

/// Runs a permutation test for a changepoint in a sequence of episodes, a change of their
/// distribution at one of the places `cuts`: numbers of episodes before the change, with at least
/// one on either side. Each of `sources` shows all episodes in their order.
///
/// Both sides of a cut are compared by their energy distance `2 E|X - Y| - E|X - X'| - E|Y - Y'|`,
/// as in Matteson and James, "A nonparametric approach for multiple change point analysis of
/// multivariate data", Journal of the American Statistical Association 109 (2014). One pass over
/// the pairs of episodes gives it for all cuts at once, where distances of Wasserstein's kind would
/// take one transport problem for each. Distances are rounded to a millionth of the largest one,
/// so that sums are whole and do not depend on their order.
///
/// # Errors
/// No source, no cut, no permutation, a cut that leaves one side empty, or sources of different
/// lengths.
pub fn changepoint_test(
    sources: &[FrameFeatures],
    cuts: &[usize],
    permutations: usize,
    rng: &mut impl Rng,
) -> Result<ChangepointTestResult> {
    let episodes = check(sources, cuts)?;
    check_positive("permutations", permutations)?;
    let scans = sources.iter().map(EnergyScan::new).collect::<Result<Vec<_>>>()?;
    let mut scans: Vec<EnergyScan> = scans.into_iter().flatten().collect();
    let mut order: Vec<usize> = (0..episodes).collect();
    for split in 0..=permutations {
        if split > 0 {
            order.shuffle(rng);
        }
        scans.iter_mut().for_each(|scan| scan.measure(&order, cuts));
    }
    Ok(summarise(&scans, cuts, permutations))
}

/// Returns the candidate changepoints for [`changepoint_test`] of episodes that began at the times
/// `began`, in order: numbers of episodes before the change, with at least `least` on either side,
/// that do not part episodes which began together.
pub fn changepoint_candidates(began: &[usize], least: usize) -> Vec<usize> {
    let least = least.max(1);
    let last = (began.len() + 1).saturating_sub(least);
    (least..last).filter(|&at| began[at] != began[at - 1]).collect()
}

/// Checks the sources and the cuts of a changepoint test; returns the number of episodes.
fn check(sources: &[FrameFeatures], cuts: &[usize]) -> Result<usize> {
    let counts: Vec<_> = sources.iter().map(|source| (source.num_episodes(), 0)).collect();
    let (all, _) = check_episode_counts(&counts)?;
    if cuts.is_empty() {
        return Err(ClusterError::Empty { what: "cuts" });
    }
    let expected = "at least 1 episode on either side";
    let mut cuts = cuts.iter().map(|&cut| (cut, (1..all).contains(&cut)));
    cuts.try_for_each(|(cut, inside)| check_range("cut", cut as f64, inside, expected))?;
    Ok(all)
}

/// Integer distances of one source, and its energy distances at all cuts: first those of the
/// observed order, then those of random orders.
struct EnergyScan {
    /// Distances between episodes, `[episodes, episodes]`.
    pairs: Vec<u64>,
    /// Sum of the distances of each episode to all others, the row sums of `pairs`.
    rows: Vec<u64>,
    /// Energy distances of all orders of the episodes at all cuts, `[orders, cuts]`.
    measured: Vec<f64>,
    /// Sums over the first k episodes of an order, for every k: of the distances among them, and of
    /// their distances to all episodes.
    sums: Vec<(u64, u64)>,
}

impl EnergyScan {
    /// Computes the distances between episodes; `None` if all points are equal.
    fn new(frames: &FrameFeatures) -> Result<Option<Self>> {
        let features = frames.features();
        let mut costs = EuclideanDistances::new();
        let distances = costs.compute(features, features, frames.dim())?;
        let largest = distances.iter().copied().fold(0.0, f64::max);
        if largest == 0.0 {
            return Ok(None);
        }
        let (k, n) = (frames.frames_per_episode(), frames.num_episodes());
        let mut pairs = vec![0; n * n];
        for (index, distance) in distances.iter().enumerate() {
            let (row, col) = (index / (n * k) / k, index % (n * k) / k);
            pairs[row * n + col] += (distance / largest * UNITS).round() as u64;
        }
        let rows = pairs.chunks_exact(n).map(|row| row.iter().sum()).collect();
        Ok(Some(Self { pairs, rows, measured: Vec::new(), sums: Vec::with_capacity(n) }))
    }

    /// Appends the energy distances of one order of the episodes at all cuts.
    fn measure(&mut self, order: &[usize], cuts: &[usize]) {
        let n = order.len();
        let (mut total, mut all_rows) = (0, 0);
        self.sums.clear();
        for (k, &episode) in order.iter().enumerate() {
            let row = &self.pairs[episode * n..][..n];
            total += 2 * order[..k].iter().map(|&other| row[other]).sum::<u64>() + row[episode];
            all_rows += self.rows[episode];
            self.sums.push((total, all_rows));
        }
        self.measured.extend(cuts.iter().map(|&cut| {
            let (left, rows) = self.sums[cut - 1];
            let between = rows - left;
            let right = total - left - 2 * between;
            let (l, r) = (cut as f64, (n - cut) as f64);
            2.0 * between as f64 / (l * r) - left as f64 / (l * l) - right as f64 / (r * r)
        }));
    }

    /// Returns the standardised energy distances of all orders of the episodes, `[orders, cuts]`.
    /// The moments of each cut are taken over all orders, including the observed one, which makes
    /// the test exact.
    fn scores(&self, width: usize) -> Vec<f64> {
        let orders = (self.measured.len() / width) as f64;
        let mut scores = self.measured.clone();
        for cut in 0..width {
            let values = || self.measured.iter().skip(cut).step_by(width);
            let mean = values().sum::<f64>() / orders;
            let variance = values().map(|v| (v - mean).powi(2)).sum::<f64>() / orders;
            let sd = variance.sqrt().max(ROUNDING * UNITS);
            let own = scores.iter_mut().skip(cut).step_by(width);
            own.for_each(|score| *score = (*score - mean) / sd);
        }
        scores
    }
}

fn summarise(scans: &[EnergyScan], cuts: &[usize], permutations: usize) -> ChangepointTestResult {
    let width = cuts.len();
    let mut largest = vec![f64::NEG_INFINITY; 1 + permutations];
    let mut best = (f64::NEG_INFINITY, 0);
    for scan in scans {
        let scores = scan.scores(width);
        for (running, chunk) in largest.iter_mut().zip(scores.chunks_exact(width)) {
            *running = chunk.iter().copied().fold(*running, f64::max);
        }
        for (index, &score) in scores[..width].iter().enumerate() {
            if score > best.0 {
                best = (score, index);
            }
        }
    }
    let reaching = largest.iter().filter(|&&m| m >= largest[0] - EQUAL).count();
    let p_value = if scans.is_empty() { 1.0 } else { reaching as f64 / (1 + permutations) as f64 };
    ChangepointTestResult { changepoint: cuts[best.1], p_value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::draw;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn both_sides_of_a_place_show_enough_episodes() {
        let places = |began: Vec<usize>| changepoint_candidates(&began, 4);
        assert_eq!(places((0..9).collect()), [4, 5]);
        assert_eq!(places((0..20).map(|i| i / 5).collect()), [5, 10, 15]);
        assert!(places((0..9).map(|i| i / 3).collect()).is_empty());
        assert!(places((0..3).collect()).is_empty() && places(Vec::new()).is_empty());
    }

    #[test]
    fn a_change_is_found_where_it_is() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let sequence = [draw(7, 0.0, &mut rng), draw(13, 3.0, &mut rng)].concat();
        let still = FrameFeatures::new(vec![1.0; 20], 1, 1).unwrap();
        let frames = [still.clone(), FrameFeatures::new(sequence, 1, 1).unwrap()];
        let cuts: Vec<usize> = (1..20).collect();
        let test = changepoint_test(&frames, &cuts, 99, &mut rng).unwrap();
        // neighbouring cuts score nearly alike
        assert!((6..=8).contains(&test.changepoint), "{}", test.changepoint);
        assert_eq!(test.p_value, 0.01);
        let nothing = changepoint_test(&[still], &cuts, 99, &mut rng).unwrap();
        assert_eq!(nothing.p_value, 1.0);
        assert!(changepoint_test(&frames, &[20], 99, &mut rng).is_err());
        assert!(changepoint_test(&frames, &[], 99, &mut rng).is_err());
    }

    /// One pass gives what the definition gives, for cuts in any order and episodes of two frames.
    #[test]
    fn one_pass_agrees_with_the_definition() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let features = draw(9 * 2 * 3, 0.0, &mut rng);
        let frames = FrameFeatures::new(features, 2, 3).unwrap();
        let cuts = [4, 2, 8, 1];
        let mut scan = EnergyScan::new(&frames).unwrap().unwrap();
        let order = [3, 8, 1, 0, 7, 2, 6, 4, 5];
        scan.measure(&order, &cuts);
        for (&cut, got) in cuts.iter().zip(&scan.measured) {
            let mean = |left: &[usize], right: &[usize]| {
                let pairs = left.iter().flat_map(|&i| right.iter().map(move |&j| (i, j)));
                let sum: u64 = pairs.map(|(i, j)| scan.pairs[i * 9 + j]).sum();
                sum as f64 / (left.len() * right.len()) as f64
            };
            let (left, right) = order.split_at(cut);
            let expected = 2.0 * mean(left, right) - mean(left, left) - mean(right, right);
            assert!((got - expected).abs() < 1e-6 * UNITS, "{cut}: {got} {expected}");
        }
    }

    /// 1000 sequences in which nothing changes, with two sources and 17 cuts.
    #[test]
    fn the_rate_of_false_alarms_is_the_level() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let cuts: Vec<usize> = (2..19).collect();
        let alarms = (0..1000).filter(|_| {
            let frames =
                [1, 3].map(|dim| FrameFeatures::new(draw(20 * dim, 0.0, &mut rng), 1, dim));
            let frames = frames.map(Result::unwrap);
            changepoint_test(&frames, &cuts, 99, &mut rng).unwrap().p_value <= 0.05
        });
        // nominal 50; four standard deviations are 28
        let alarms = alarms.count();
        assert!((22..=78).contains(&alarms), "{alarms}");
    }
}

//! Two-sample permutation test on the 1-Wasserstein distance, by whole episodes.

use rand::Rng;
use rand::seq::SliceRandom;

use crate::ClusterError;
use crate::euclidean::EuclideanCosts;
use crate::frames::{Candidate, Frames};
use crate::settings::Calibrated;
use crate::transport::{Solver, Weights};

/// Rounding allowance for the spread of the null distribution, as a fraction of the largest pooled
/// distance.
const SPREAD_FLOOR: f64 = 1e-9;

/// Result of a permutation test. All values are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PermutationTest {
    /// `W1` between the episodes of the rollout and those of the buffer that entered the test.
    pub distance: f64,
    /// Mean of `W1` over random splits of the pooled episodes.
    pub mean: f64,
    /// Standard deviation of `W1` over random splits.
    pub sd: f64,
    /// Largest `W1` over random splits.
    pub max: f64,
    /// `(distance - mean) / sd`; zero where all splits and the distance agree.
    pub score: f64,
    /// `distance / max`; zero where all pooled frames are equal.
    pub ratio: f64,
}

/// Runs the test of "rollout and buffer have one distribution" for a checked candidate.
///
/// The frames of one episode are alike, so they are no independent draws: episodes are the units
/// that are pooled and split at random, never frames. One matrix of distances between the pooled
/// frames serves all splits.
pub(crate) fn permutation_test<R: Rng + ?Sized>(
    candidate: &Candidate,
    settings: &Calibrated,
    rng: &mut R,
) -> Result<PermutationTest, ClusterError> {
    let mut pool = Pool::default();
    let rollout = pool.add_sample(&candidate.rollout, settings.rollout_episodes, rng);
    let buffer = pool.add_sample(&candidate.buffer, settings.buffer_episodes, rng);
    let mut distances = PooledDistances::new(&pool.features, &candidate.rollout)?;

    let mut order: Vec<usize> = (0..rollout + buffer).collect();
    let distance = distances.between(&order, rollout)?;
    let mut null = Vec::with_capacity(settings.permutations);
    for _ in 0..settings.permutations {
        order.shuffle(rng);
        null.push(distances.between(&order, rollout)?);
    }
    Ok(summarise(
        distance,
        &null,
        SPREAD_FLOOR * distances.largest(),
    ))
}

/// Features of the episodes that enter the test.
#[derive(Default)]
struct Pool {
    features: Vec<f32>,
}

impl Pool {
    /// Adds at most `limit` episodes drawn without replacement; returns how many.
    fn add_sample<R: Rng + ?Sized>(&mut self, frames: &Frames, limit: usize, rng: &mut R) -> usize {
        let mut episodes: Vec<usize> = (0..frames.episodes()).collect();
        let (chosen, _) = episodes.partial_shuffle(rng, limit);
        for &episode in chosen.iter() {
            self.features.extend_from_slice(frames.episode(episode));
        }
        chosen.len()
    }
}

/// Distances between all pooled frames, and the memory for the part that one split needs.
struct PooledDistances {
    all: Vec<f64>,
    frames: usize,
    per_episode: usize,
    cost: Vec<f64>,
    solver: Solver,
}

impl PooledDistances {
    fn new(features: &[f32], like: &Frames) -> Result<Self, ClusterError> {
        let all = EuclideanCosts::new()
            .compute(features, features, like.dim())?
            .to_vec();
        let frames = features.len() / like.dim();
        Ok(Self {
            all,
            frames,
            per_episode: like.frames_per_episode(),
            cost: Vec::new(),
            solver: Solver::new(),
        })
    }

    fn largest(&self) -> f64 {
        self.all.iter().copied().fold(0.0, f64::max)
    }

    /// Returns `W1` between the first `split` episodes of `order` and the rest.
    fn between(&mut self, order: &[usize], split: usize) -> Result<f64, ClusterError> {
        let k = self.per_episode;
        let (left, right) = order.split_at(split);
        self.cost.clear();
        for frame in left
            .iter()
            .flat_map(|episode| episode * k..(episode + 1) * k)
        {
            let row = &self.all[frame * self.frames..][..self.frames];
            for episode in right {
                self.cost
                    .extend_from_slice(&row[episode * k..(episode + 1) * k]);
            }
        }
        let sides = [left, right].map(|side| Weights::Uniform(side.len() * k));
        Ok(self.solver.solve(&self.cost, sides[0], sides[1])?.cost)
    }
}

/// The floor keeps the score and the ratio finite where all splits are equally far apart.
fn summarise(distance: f64, null: &[f64], floor: f64) -> PermutationTest {
    let count = null.len() as f64;
    let mean = null.iter().sum::<f64>() / count;
    let variance = null.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let sd = variance.sqrt();
    let max = null.iter().copied().fold(0.0, f64::max);
    let floor = floor.max(f64::MIN_POSITIVE);
    let score = (distance - mean) / sd.max(floor);
    PermutationTest {
        distance,
        mean,
        sd,
        max,
        score,
        ratio: distance / max.max(floor),
    }
}

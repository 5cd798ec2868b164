//! Synthetic episodes: Gaussians in 64 dimensions whose frames are alike within an episode, and
//! whose rollouts drift.

use cluster::{ClusterError, Frames};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

pub const DIM: usize = 64;
/// Number of episodes of one rollout.
pub const ROLLOUT: usize = 20;
/// Ratio of the spread of one coordinate to that of the one before: about ten of the 64 directions
/// carry the variance, as the few degrees of freedom of a scene do.
const DECAY: f32 = 0.9;
/// Share of the variance that all frames of one episode have in common.
const COMMON: f32 = 0.9;

/// Distribution that cases are drawn from. Lengths are in units of the spread of episodes.
#[derive(Clone, Copy, Debug)]
pub struct Scenario {
    /// Number of frames of an episode.
    pub frames: usize,
    /// Spread of the offsets that whole rollouts have within a group.
    pub drift: f32,
    /// Spread of the centres of groups.
    pub apart: f32,
    /// Number of clusters that episodes of a group come from, such as variants of a task.
    pub clusters: usize,
    /// Range, ends included, of the number of rollouts in the buffer.
    pub rollouts: (usize, usize),
}

/// Scenario that resembles a stream of tasks: one frame for each episode.
pub const MAIN: Scenario =
    Scenario { frames: 1, drift: 0.0, apart: 1.0, clusters: 1, rollouts: (1, 5) };

/// Input of one decision: the candidate's buffer, a rollout, and another one for rules that ask for
/// it.
pub struct Case {
    pub buffer: Frames,
    pub rollout: Frames,
    pub another: Frames,
}

/// Group of episodes, by the centres of its clusters.
struct Group {
    clusters: Vec<Vec<f32>>,
}

impl Scenario {
    /// Draws a case, whose rollout is of the buffer's group if `same` is `true`, and of another
    /// group otherwise.
    pub fn draw(&self, same: bool, rng: &mut ChaCha8Rng) -> Result<Case, ClusterError> {
        let group = Group::draw(self, rng);
        let mut buffer = Vec::new();
        for _ in 0..rng.random_range(self.rollouts.0..=self.rollouts.1) {
            let drift = spread(self.drift, rng);
            group.roll_out(self, &drift, &mut buffer, rng);
        }
        let group = if same { group } else { Group::draw(self, rng) };
        // the same policy acts in both: they drift alike, which is the harder case
        let drift = spread(self.drift, rng);
        let mut one_more = || {
            let mut features = Vec::new();
            group.roll_out(self, &drift, &mut features, rng);
            self.frames(features)
        };
        Ok(Case { rollout: one_more()?, another: one_more()?, buffer: self.frames(buffer)? })
    }

    fn frames(&self, features: Vec<f32>) -> Result<Frames, ClusterError> {
        Frames::new(features, self.frames, DIM)
    }
}

impl Group {
    fn draw(scenario: &Scenario, rng: &mut ChaCha8Rng) -> Self {
        // two centres are apart by sqrt(2) times the spread of one
        let centre = spread(scenario.apart / 2.0_f32.sqrt(), rng);
        let cluster = |_| match scenario.clusters {
            1 => centre.clone(),
            _ => sum(&centre, &spread(1.0, rng)),
        };
        Self { clusters: (0..scenario.clusters).map(cluster).collect() }
    }

    fn roll_out(
        &self,
        scenario: &Scenario,
        drift: &[f32],
        out: &mut Vec<f32>,
        rng: &mut ChaCha8Rng,
    ) {
        // within clusters episodes vary less, so that a group has one spread in all scenarios
        let share = if self.clusters.len() == 1 { 1.0 } else { 0.1 };
        for _ in 0..ROLLOUT {
            let cluster = &self.clusters[rng.random_range(0..self.clusters.len())];
            let start = sum(&sum(cluster, drift), &spread((share * COMMON).sqrt(), rng));
            for _ in 0..scenario.frames {
                let own = spread((share * (1.0 - COMMON)).sqrt(), rng);
                out.extend(sum(&start, &own));
            }
        }
    }
}

fn sum(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// Draws a normal vector whose coordinates have the spread `size`, `size DECAY`, `size DECAY^2`,
/// ...
fn spread(size: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let coordinate = |i: usize| size * DECAY.powi(i as i32) * normal(rng);
    (0..DIM).map(coordinate).collect()
}

/// Draws a standard normal number (Box-Muller).
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}

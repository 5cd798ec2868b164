//! A point that reaches a goal it only sees: the toy environment of this crate's tests, exactly
//! D2-symmetric.

pub mod ages;
pub mod episodes;
pub mod guess;
pub mod joint;
pub mod largest;
pub mod parts;
pub mod sac;
pub mod toy;
pub mod unseeing;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations};
use symmetry::Irrep;

use toy::{Toy, Toys};

/// Height and width of the pictures in pixels.
pub const PIXELS: usize = 8;
/// Decisions an episode lasts.
pub const EPISODE: usize = 10;
/// Distance that an action of 1 covers in the unit square [-1, 1]^2.
const STEP: f32 = 0.4;
/// Distance from the goal, per axis, that counts as success.
const NEAR: f32 = 0.25;

/// N points in [-1, 1]^2. Picture: the goal in channel 0, the point in channel 1. Vector: the
/// point. Reward: 1 minus the mean distance per axis, in [0, 1]. Episodes last [`EPISODE`]
/// decisions.
pub type PointReach = Toys<Points>;

#[derive(Clone)]
pub struct Points {
    points: Vec<[f32; 2]>,
    goals: Vec<[f32; 2]>,
    rng: ChaCha8Rng,
}

impl PointReach {
    pub fn new(num_envs: usize, seed: u64) -> Self {
        let xy = vec![Irrep::X, Irrep::Y];
        let points = Points {
            points: vec![[0.0; 2]; num_envs],
            goals: vec![[0.0; 2]; num_envs],
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        let spec = EnvSpec {
            num_envs,
            image: [PIXELS, PIXELS, 2],
            vector: xy.clone(),
            action: xy,
        };
        Self::of(points, spec)
    }
}

impl Toy for Points {
    const EPISODE: usize = EPISODE;

    fn restart(&mut self, n: usize) {
        self.points[n] = [0.0; 2];
        self.goals[n] = std::array::from_fn(|_| self.rng.random_range(-0.9..0.9));
    }

    fn observe(&self, n: usize, out: &mut Observations) {
        let len = PIXELS * PIXELS * 2;
        let image = &mut out.images[n * len..(n + 1) * len];
        image.fill(0);
        draw(image, 0, self.goals[n]);
        draw(image, 1, self.points[n]);
        out.vectors[2 * n..2 * n + 2].copy_from_slice(&self.points[n]);
    }

    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool) {
        for (p, a) in self.points[n].iter_mut().zip(action) {
            *p = (*p + STEP * a.clamp(-1.0, 1.0)).clamp(-1.0, 1.0);
        }
        let distance: [f32; 2] =
            std::array::from_fn(|i| (self.points[n][i] - self.goals[n][i]).abs());
        let reward = (1.0 - (distance[0] + distance[1]) / 2.0).max(0.0);
        (reward, distance.iter().all(|&d| d < NEAR))
    }
}

/// Spreads a point over the four nearest pixels, bilinearly.
fn draw(image: &mut [u8], channel: usize, [x, y]: [f32; 2]) {
    let scale = (PIXELS - 1) as f32 / 2.0;
    let (column, row) = ((x + 1.0) * scale, (1.0 - y) * scale);
    for r in 0..PIXELS {
        for c in 0..PIXELS {
            let weight = (1.0 - (row - r as f32).abs()).max(0.0)
                * (1.0 - (column - c as f32).abs()).max(0.0);
            image[(r * PIXELS + c) * 2 + channel] = (255.0 * weight).round() as u8;
        }
    }
}

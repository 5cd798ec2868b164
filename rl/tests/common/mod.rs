//! Toy environment of this crate's tests, exactly D2-symmetric: a point has to reach a goal that is
//! only in the image.

pub mod actors;
pub mod episodes;
pub mod guess;
pub mod sac;
pub mod steps;
pub mod toy;

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
/// point, and the goal where the vector has four components. Reward: 1 minus the mean distance per
/// axis, in [0, 1]. Episodes last [`EPISODE`] decisions.
pub type PointReach = Toys<Points>;

#[derive(Clone)]
pub struct Points {
    image: [usize; 3],
    components: usize,
    points: Vec<[f32; 2]>,
    goals: Vec<[f32; 2]>,
    rng: ChaCha8Rng,
}

impl PointReach {
    pub fn new(num_envs: usize, seed: u64) -> Self {
        Self::showing(num_envs, seed, [PIXELS, PIXELS, 2], 2)
    }

    /// Points with pictures of another size or none, and vectors of 0, 2 or 4 components.
    pub fn showing(num_envs: usize, seed: u64, image: [usize; 3], components: usize) -> Self {
        let xy = vec![Irrep::X, Irrep::Y];
        let points = Points {
            image,
            components,
            points: vec![[0.0; 2]; num_envs],
            goals: vec![[0.0; 2]; num_envs],
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        let spec = EnvSpec {
            num_envs,
            image_shape: image,
            vector_irreps: xy.repeat(components / 2),
            action_irreps: xy,
            choices: vec![],
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
        let (len, d) = (self.image.iter().product::<usize>(), self.components);
        let image = &mut out.images[n * len..(n + 1) * len];
        image.fill(0);
        draw(image, self.image, 0, self.goals[n]);
        draw(image, self.image, 1, self.points[n]);
        let both = [self.points[n], self.goals[n]].concat();
        out.vectors[d * n..d * (n + 1)].copy_from_slice(&both[..d]);
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
fn draw(image: &mut [u8], [height, width, _]: [usize; 3], channel: usize, [x, y]: [f32; 2]) {
    let scale = |size: usize| (size as f32 - 1.0) / 2.0;
    let (column, row) = ((x + 1.0) * scale(width), (1.0 - y) * scale(height));
    for r in 0..height {
        for c in 0..width {
            let weight = (1.0 - (row - r as f32).abs()).max(0.0)
                * (1.0 - (column - c as f32).abs()).max(0.0);
            image[(r * width + c) * 2 + channel] = (255.0 * weight).round() as u8;
        }
    }
}

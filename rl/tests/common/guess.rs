//! Two vector tasks without pictures: one that shows its goal and one that only rewards tell.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations};
use symmetry::Irrep;

use super::toy::{Toy, Toys};

/// Decisions an episode lasts.
pub const EPISODE: usize = 8;

/// N numbers in [-1, 1], a goal each, drawn anew for every episode. The reward is 1 minus the
/// distance of the action from the goal. Pictures are one black pixel. Episodes last
/// [`EPISODE`] decisions.
pub type Guess = Toys<Goals>;

pub struct Goals {
    shown: bool,
    goals: Vec<f32>,
    rng: ChaCha8Rng,
}

impl Guess {
    /// With `shown`, goals are any numbers and are the observation's vector. Without, they are -1
    /// or 1, and the vector is zero.
    pub fn new(num_envs: usize, shown: bool, seed: u64) -> Self {
        let goals =
            Goals { shown, goals: vec![0.0; num_envs], rng: ChaCha8Rng::seed_from_u64(seed) };
        let spec = EnvSpec {
            num_envs,
            image_shape: [1, 1, 1],
            vector_irreps: vec![Irrep::X],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        };
        Self::of(goals, spec)
    }
}

impl Toy for Goals {
    const EPISODE: usize = EPISODE;

    fn restart(&mut self, n: usize) {
        let goal = self.rng.random_range(-0.9..0.9_f32);
        self.goals[n] = if self.shown { goal } else { goal.signum() };
    }

    fn observe(&self, n: usize, out: &mut Observations) {
        out.images[n] = 0;
        out.vectors[n] = if self.shown { self.goals[n] } else { 0.0 };
    }

    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool) {
        let distance = (action[0].clamp(-1.0, 1.0) - self.goals[n]).abs();
        (1.0 - distance, false)
    }
}

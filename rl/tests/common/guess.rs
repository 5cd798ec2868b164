//! Two vector tasks without pictures: one that shows its goal and one that only rewards tell.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};
use symmetry::Irrep;

/// Decisions an episode lasts.
pub const EPISODE: usize = 8;

/// N numbers in [-1, 1], a goal each, drawn anew for every episode. The reward is 1 minus the
/// distance of the action from the goal. Pictures are one black pixel.
pub struct Guess {
    spec: EnvSpec,
    shown: bool,
    goals: Vec<f32>,
    age: usize,
    rng: ChaCha8Rng,
}

impl Guess {
    /// With `shown`, goals are any numbers and are the observation's vector. Without, they are -1
    /// or 1, and the vector is zero.
    pub fn new(num_envs: usize, shown: bool, seed: u64) -> Self {
        Self {
            spec: EnvSpec {
                num_envs,
                image: [1, 1, 1],
                vector: vec![Irrep::X],
                action: vec![Irrep::X],
            },
            shown,
            goals: vec![0.0; num_envs],
            age: 0,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    fn restart(&mut self) {
        self.age = 0;
        for goal in &mut self.goals {
            *goal = self.rng.random_range(-0.9..0.9);
            if !self.shown {
                *goal = goal.signum();
            }
        }
    }

    fn observe(&self, out: &mut Observations) {
        out.images.fill(0);
        out.vectors.fill(0.0);
        if self.shown {
            out.vectors.copy_from_slice(&self.goals);
        }
    }
}

impl VectorEnv for Guess {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(EPISODE)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        self.restart();
        self.observe(out);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        self.age += 1;
        let over = self.age == EPISODE;
        for (n, (action, goal)) in actions.iter().zip(&self.goals).enumerate() {
            out.rewards[n] = 1.0 - (action.clamp(-1.0, 1.0) - goal).abs();
            out.outcomes[n] = [Outcome::Running, Outcome::Truncated][usize::from(over)];
        }
        if over {
            self.observe(&mut out.final_observations);
            self.restart();
        }
        self.observe(&mut out.observations);
        Ok(())
    }
}

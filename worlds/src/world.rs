//! Worlds: groups and their surroundings, drawn from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::group::Group;
use crate::kind::Kind;

/// What surrounds the object of every group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Grey of the ground, in 0..=255.
    pub ground: f32,
    /// Small grey things that lie elsewhere in every episode.
    pub clutter: usize,
    /// How much brighter or darker episodes are, as a share.
    pub light: f32,
    /// Most that the camera adds to a value or takes from it, in 0..=255.
    pub noise: f32,
    /// Where objects lie: from and to this far from the middle, in x and in y, in units of half the
    /// picture's side.
    pub places: [f32; 2],
}

/// Groups of tasks in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// In what the groups differ.
    pub kind: Kind,
    /// What the world was drawn from; episodes are drawn from it, too.
    pub seed: u64,
    /// The groups.
    pub groups: Vec<Group>,
    /// What surrounds them.
    pub scene: Scene,
}

impl World {
    /// Draws a world with as many groups as the kind likes.
    pub fn draw(kind: Kind, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let number = kind.number(&mut rng);
        Self::with_rng(kind, seed, number, rng)
    }

    /// Draws a world with `number` groups, or as many as the kind can make differ: from 4 for
    /// [`Kind::Reward`] to 16.
    pub fn with_groups(kind: Kind, seed: u64, number: usize) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self::with_rng(kind, seed, number.clamp(1, kind.most()), rng)
    }

    fn with_rng(kind: Kind, seed: u64, number: usize, mut rng: ChaCha8Rng) -> Self {
        let groups = kind.groups(number, &mut rng);
        let scene = Scene::draw(kind, &mut rng);
        Self { kind, seed, groups, scene }
    }

    /// The number of policies that the world asks for: groups of one and the same task count once.
    pub fn distinct(&self) -> usize {
        match self.kind {
            Kind::Identical => 1,
            _ => self.groups.len(),
        }
    }

    /// The group that stands for `group`: equal groups have one in common.
    pub fn representative(&self, group: usize) -> usize {
        match self.kind {
            Kind::Identical => 0,
            _ => group,
        }
    }
}

impl Scene {
    /// Appearance worlds have wide placements; others draw their width.
    fn draw(kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        let wide = kind == Kind::Appearance;
        let width = if wide { 0.5 } else { rng.random_range(0.05..0.5) };
        let from = 0.2 + rng.random_range(0.0..=1.0) * (0.5 - width);
        Self {
            ground: rng.random_range(90.0..160.0),
            clutter: rng.random_range(0..=3),
            light: rng.random_range(0.0..0.12),
            noise: rng.random_range(0.0..8.0),
            places: [from, from + width],
        }
    }
}

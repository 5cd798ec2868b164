//! Worlds: groups and their surroundings, drawn from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::group::TaskGroup;
use crate::kind::WorldKind;

/// Surroundings of the object, which all groups of a world share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Grey value of the ground, in 0..=255.
    pub ground_grey: f32,
    /// Number of small grey objects on the ground, at new positions in every episode.
    pub num_clutter_objects: usize,
    /// Largest relative deviation of an episode's brightness from 1.
    pub max_light_deviation: f32,
    /// Amplitude of the uniform camera noise, in levels of 0..=255.
    pub noise_amplitude: f32,
    /// Range of both coordinates of an object, from the centre of the picture, in units of half its
    /// side.
    pub object_range: [f32; 2],
}

/// World of synthetic tasks: task groups in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Kind of the world: the properties in which its groups differ.
    pub kind: WorldKind,
    /// Seed of the world and of all episodes in it.
    pub seed: u64,
    /// Task groups of the world.
    pub groups: Vec<TaskGroup>,
    /// Surroundings of the object, which all groups share.
    pub scene: Scene,
}

impl World {
    /// Draws a random world with the kind's default number of groups.
    pub fn random(kind: WorldKind, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let number = kind.draw_num_groups(&mut rng);
        Self::with_rng(kind, seed, number, rng)
    }

    /// Draws a random world with `number` task groups, at least 1 and at most the kind's largest
    /// number, which is 4 for [`WorldKind::Reward`] and up to 16 for others.
    pub fn random_with_num_groups(kind: WorldKind, seed: u64, number: usize) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self::with_rng(kind, seed, number.clamp(1, kind.max_num_groups()), rng)
    }

    fn with_rng(kind: WorldKind, seed: u64, number: usize, mut rng: ChaCha8Rng) -> Self {
        let groups = kind.draw_groups(number, &mut rng);
        let scene = Scene::draw(kind, &mut rng);
        Self { kind, seed, groups, scene }
    }

    /// Returns the number of policies that the world requires: equal groups count once.
    pub fn num_distinct_groups(&self) -> usize {
        match self.kind {
            WorldKind::Identical => 1,
            _ => self.groups.len(),
        }
    }

    /// Returns the index of the first of the groups that are equal to `group`.
    pub fn first_equal_group(&self, group: usize) -> usize {
        match self.kind {
            WorldKind::Identical => 0,
            _ => group,
        }
    }
}

impl Scene {
    /// Draws surroundings; positions range widely for [`WorldKind::Appearance`] only.
    fn draw(kind: WorldKind, rng: &mut ChaCha8Rng) -> Self {
        // appearance worlds have the widest range, 0.2 to 0.7; others draw a width from 0.05 to 0.5
        let wide = kind == WorldKind::Appearance;
        let width = if wide { 0.5 } else { rng.random_range(0.05..0.5) };
        let from = 0.2 + rng.random_range(0.0..=1.0) * (0.5 - width);
        Self {
            ground_grey: rng.random_range(90.0..160.0),
            num_clutter_objects: rng.random_range(0..=3),
            max_light_deviation: rng.random_range(0.0..0.12),
            noise_amplitude: rng.random_range(0.0..8.0),
            object_range: [from, from + width],
        }
    }
}

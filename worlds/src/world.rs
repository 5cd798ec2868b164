//! Worlds: task groups and their surroundings, random but determined by a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::group::TaskGroup;
use crate::kind::WorldKind;
use crate::scene::SceneSettings;

/// World of synthetic tasks: task groups in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    /// Kind of the world: the properties in which its groups differ.
    pub kind: WorldKind,
    /// Seed of the random numbers of the world and of all episodes in it.
    pub seed: u64,
    /// Task groups of the world.
    pub groups: Vec<TaskGroup>,
    /// Surroundings of the objects at the beginning of a stream of tasks, before rewards are
    /// scaled.
    pub scene: SceneSettings,
    /// Surroundings of the objects at the largest change that the nuisance of the kind of world
    /// causes.
    pub changed_scene: SceneSettings,
}

impl World {
    /// Draws a random world, with a random number of groups in the kind's default range.
    pub fn random(kind: WorldKind, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let number = kind.draw_num_groups(&mut rng);
        Self::with_rng(kind, seed, number, rng)
    }

    /// Draws a random world with `number` task groups; fewer than 1 count as 1, and more than the
    /// kind's maximum, which is 4 to 16, as the maximum.
    pub fn random_with_num_groups(kind: WorldKind, seed: u64, number: usize) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self::with_rng(kind, seed, number.clamp(1, kind.max_num_groups()), rng)
    }

    fn with_rng(kind: WorldKind, seed: u64, number: usize, mut rng: ChaCha8Rng) -> Self {
        let groups = kind.draw_groups(number, &mut rng);
        let scene = draw_scene(kind, &mut rng);
        let [scene, changed_scene] = kind.nuisance()(scene, &mut rng);
        Self { kind, seed, groups, scene, changed_scene }
    }

    /// Returns the surroundings of the objects in round `round` of a stream of tasks, which belongs
    /// to visit `visit`.
    pub fn scene_in_round(&self, round: usize, visit: usize) -> SceneSettings {
        let (from, to) = (&self.scene, &self.changed_scene);
        // rises to 1 and returns to 0
        let share = 1.0 - (1.0 - (round as f32 / CHANGE_ROUNDS).rem_euclid(2.0)).abs();
        let mix = |first: f32, last: f32| first + share * (last - first);
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        // streams from 0 on drew the world and its episodes
        rng.set_stream(u64::MAX - visit as u64);
        SceneSettings {
            ground: std::array::from_fn(|i| mix(from.ground[i], to.ground[i])),
            brightness: mix(from.brightness, to.brightness),
            noise_amplitude: mix(from.noise_amplitude, to.noise_amplitude),
            object_range: std::array::from_fn(|i| mix(from.object_range[i], to.object_range[i])),
            reward_scale: to.reward_scale.powf(rng.random_range(-1.0..1.0)),
            ..*from
        }
    }

    /// Returns the number of policies that the world requires: equal groups count once.
    pub fn num_distinct_groups(&self) -> usize {
        if self.kind.varying_properties().is_empty() { 1 } else { self.groups.len() }
    }

    /// Returns the smallest index of a task group that equals the one with index `group`.
    pub fn first_equal_group(&self, group: usize) -> usize {
        if self.kind.varying_properties().is_empty() { 0 } else { group }
    }
}

/// Number of rounds in which the nuisance changes a scene from one extreme to the other.
const CHANGE_ROUNDS: f32 = 250.0;

/// Returns random surroundings; positions of objects range widely for [`WorldKind::Appearance`]
/// only.
fn draw_scene(kind: WorldKind, rng: &mut ChaCha8Rng) -> SceneSettings {
    // appearance worlds have the widest range, 0.2 to 0.7; others draw a width from 0.05 to 0.5
    let wide = kind == WorldKind::Appearance;
    let width = if wide { 0.5 } else { rng.random_range(0.05..0.5) };
    let from = 0.2 + rng.random_range(0.0..=1.0) * (0.5 - width);
    SceneSettings {
        ground: [rng.random_range(90.0..160.0); 3],
        num_clutter_objects: rng.random_range(0..=3),
        brightness: 1.0,
        max_light_deviation: rng.random_range(0.0..0.12),
        noise_amplitude: rng.random_range(0.0..8.0),
        object_range: [from, from + width],
        decisions_without_object: if kind == WorldKind::LateObject { 5 } else { 0 },
        reward_scale: 1.0,
    }
}

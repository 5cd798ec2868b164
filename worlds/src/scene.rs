//! Surroundings that all groups of a world share, and their changes in the course of a stream.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Surroundings of the object, which all groups of a world share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Colour of the ground, in 0..=255: grey, unless it changes with time.
    pub ground: [f32; 3],
    /// Number of small grey objects on the ground, at new positions in every episode.
    pub num_clutter_objects: usize,
    /// Mean factor on the brightness of the pictures, over episodes; 1 leaves colours as they are.
    pub brightness: f32,
    /// Largest random deviation of an episode's brightness, relative to the mean.
    pub max_light_deviation: f32,
    /// Amplitude of the uniform camera noise, in levels of 0..=255.
    pub noise_amplitude: f32,
    /// Range of both coordinates of an object, from the centre of the picture, in units of half its
    /// side.
    pub object_range: [f32; 2],
    /// Number of decisions of an episode before the object appears.
    pub decisions_without_object: usize,
    /// Factor that multiplies all rewards.
    pub reward_scale: f32,
}

/// Change of the scene that requires no other policy: a function that returns the scene at the
/// beginning of a stream of tasks and at the largest change.
pub(crate) type Nuisance = fn(Scene, &mut ChaCha8Rng) -> [Scene; 2];

pub(crate) fn unchanged(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene; 2]
}

/// Returns the scene before and after objects move away from the picture's centre, or towards it.
pub(crate) fn move_object(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    let ranges = if rng.random() { [[0.1, 0.2], [0.4, 0.5]] } else { [[0.4, 0.5], [0.1, 0.2]] };
    ranges.map(|object_range| Scene { object_range, ..scene })
}

/// Returns the scene before and after pictures become brighter or darker.
pub(crate) fn change_light(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { brightness: if rng.random() { 1.3 } else { 0.6 }, ..scene }]
}

/// Returns the scene before and after the ground's colour channels change by random amounts.
pub(crate) fn tint_ground(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    let ground = scene.ground.map(|level| level + rng.random_range(-35.0..35.0));
    [scene, Scene { ground, ..scene }]
}

/// Returns the scene and a copy with reward scale 100; visits draw scales from 0.01 to 100.
pub(crate) fn rescale_rewards(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { reward_scale: 100.0, ..scene }]
}

/// Returns the scene before and after the camera's noise increases to 20 levels.
pub(crate) fn raise_noise(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { noise_amplitude: 20.0, ..scene }]
}

//! Surroundings that all groups of a world share, and their changes in the course of a stream.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Settings of the surroundings of the objects, which all groups of a world share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneSettings {
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

/// Change of the scene that requires no other policy: a function that turns a scene into that at
/// the beginning of a stream of tasks and that at the largest change.
pub(crate) type Nuisance = fn(SceneSettings, &mut ChaCha8Rng) -> [SceneSettings; 2];

pub(crate) fn unchanged(scene: SceneSettings, _: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    [scene; 2]
}

/// Returns the scene at the beginning of a stream and at its largest change, where objects lie
/// further from the picture's centre, or closer to it.
pub(crate) fn move_object(scene: SceneSettings, rng: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    let ranges = if rng.random() { [[0.1, 0.2], [0.4, 0.5]] } else { [[0.4, 0.5], [0.1, 0.2]] };
    ranges.map(|object_range| SceneSettings { object_range, ..scene })
}

/// Returns the scene at the beginning of a stream and at its largest change, where pictures are
/// brighter or darker.
pub(crate) fn change_light(scene: SceneSettings, rng: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    [scene, SceneSettings { brightness: if rng.random() { 1.3 } else { 0.6 }, ..scene }]
}

/// Returns the scene at the beginning of a stream and at its largest change, where the ground's
/// colour channels differ by random amounts.
pub(crate) fn tint_ground(scene: SceneSettings, rng: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    let ground = scene.ground.map(|level| level + rng.random_range(-35.0..35.0));
    [scene, SceneSettings { ground, ..scene }]
}

/// Returns the scene and a copy with reward scale 100, from which every visit draws a scale between
/// 0.01 and 100.
pub(crate) fn rescale_rewards(scene: SceneSettings, _: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    [scene, SceneSettings { reward_scale: 100.0, ..scene }]
}

/// Returns the scene at the beginning of a stream and at its largest change, where the camera's
/// noise has 20 levels.
pub(crate) fn raise_noise(scene: SceneSettings, _: &mut ChaCha8Rng) -> [SceneSettings; 2] {
    [scene, SceneSettings { noise_amplitude: 20.0, ..scene }]
}

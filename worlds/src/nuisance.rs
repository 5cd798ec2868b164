//! Changes in the course of a stream that leave the task groups as they are.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::world::Scene;

/// Returns a scene at the beginning of a stream and at the largest change.
pub(crate) type Nuisance = fn(Scene, &mut ChaCha8Rng) -> [Scene; 2];

pub(crate) fn unchanged(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene; 2]
}

/// Moves objects away from the centre of the picture, or towards it.
pub(crate) fn farther(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    let ranges = if rng.random() { [[0.1, 0.2], [0.4, 0.5]] } else { [[0.4, 0.5], [0.1, 0.2]] };
    ranges.map(|object_range| Scene { object_range, ..scene })
}

/// Makes pictures brighter or darker.
pub(crate) fn brighter(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { brightness: if rng.random() { 1.3 } else { 0.6 }, ..scene }]
}

/// Changes each channel of the ground.
pub(crate) fn tinted(scene: Scene, rng: &mut ChaCha8Rng) -> [Scene; 2] {
    let ground = scene.ground.map(|level| level + rng.random_range(-35.0..35.0));
    [scene, Scene { ground, ..scene }]
}

/// Multiplies rewards by up to 100, or divides them.
pub(crate) fn rescaled(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { reward_scale: 100.0, ..scene }]
}

/// Raises the camera's noise.
pub(crate) fn noisier(scene: Scene, _: &mut ChaCha8Rng) -> [Scene; 2] {
    [scene, Scene { noise_amplitude: 20.0, ..scene }]
}

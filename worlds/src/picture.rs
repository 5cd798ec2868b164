//! Rendering of pictures from above, in one frame of reference.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::appearance::{Appearance, Shape, Texture};
use crate::group::TaskGroup;
use crate::scene::SceneSettings;

/// Width and height of a picture in pixels.
pub(crate) const PICTURE_SIZE: usize = 48;
/// Number of sample points along each side of a pixel, for anti-aliasing.
const SAMPLES: usize = 2;

/// Appearance of the hand, in a colour that no object has.
const HAND: Appearance = Appearance {
    colour: [250.0, 120.0, 20.0],
    shape: Shape::Disc,
    half_size: 0.07,
    texture: Texture::Plain,
    num_copies: 1,
};

/// Rendered picture `[48, 48, 3]` of a world from above, not yet clipped to 0..=255; row 0 is the
/// largest y, column 0 the least x.
#[derive(Clone, Debug)]
pub(crate) struct Picture(Vec<f32>);

impl Picture {
    /// Paints the scene of a task group without the hand: ground, clutter and, if it is seen, the
    /// object, in the light of one episode.
    pub fn render_without_hand(
        scene: &SceneSettings,
        group: &TaskGroup,
        object: [f32; 2],
        is_seen: bool,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let ground: [f32; 3] = std::array::from_fn(|i| scene.ground[i] + group.ground_tint[i]);
        let mut picture = Self(ground.repeat(PICTURE_SIZE * PICTURE_SIZE));
        for _ in 0..scene.num_clutter_objects {
            let place = [0; 2].map(|_| rng.random_range(-0.95..0.95));
            picture.paint(&clutter(rng), place);
        }
        for [dx, dy] in group.appearance.copy_centres().filter(|_| is_seen) {
            picture.paint(&group.appearance, [object[0] + dx, object[1] + dy]);
        }
        let deviation = rng.random_range(-1.0..=1.0) * scene.max_light_deviation;
        let light = scene.brightness * (1.0 + deviation);
        picture.0.iter_mut().for_each(|value| *value *= light);
        picture
    }

    /// Returns a copy of the picture with the hand painted over it.
    pub fn with_hand(&self, hand: [f32; 2]) -> Self {
        let mut picture = self.clone();
        picture.paint(&HAND, hand);
        picture
    }

    /// Returns the camera picture `[48, 48, 3]` as bytes, after adding uniform noise of at most
    /// `noise` levels either way.
    pub fn to_noisy_bytes(&self, noise: f32, rng: &mut ChaCha8Rng) -> Vec<u8> {
        // one random byte for each value: the noise has 256 levels
        let mut grain = vec![0; self.0.len()];
        rng.fill(&mut grain[..]);
        let values = self.0.iter().zip(grain);
        values
            .map(|(value, speck): (_, u8)| (value + noise * (f32::from(speck) / 127.5 - 1.0)) as u8)
            .collect()
    }

    /// Paints one copy of an object; pixels that it covers in part are blended.
    fn paint(&mut self, appearance: &Appearance, [x, y]: [f32; 2]) {
        for row in pixels(-(y + appearance.half_size), -(y - appearance.half_size)) {
            for col in pixels(x - appearance.half_size, x + appearance.half_size) {
                let (share, brightness) = cover(appearance, x, y, row, col);
                let pixel = &mut self.0[(row * PICTURE_SIZE + col) * 3..][..3];
                for (value, colour) in pixel.iter_mut().zip(appearance.colour) {
                    *value += brightness * colour - share * *value;
                }
            }
        }
    }
}

/// Returns the range of indices of the pixels between two coordinates in `[-1, 1]`, along one side
/// of the picture.
fn pixels(from: f32, to: f32) -> std::ops::Range<usize> {
    let pixel = |place: f32| (place + 1.0) * PICTURE_SIZE as f32 / 2.0;
    pixel(from).floor().max(0.0) as usize..(pixel(to).ceil().max(0.0) as usize).min(PICTURE_SIZE)
}

/// Returns the share of a pixel that an object covers, and that share weighted by the brightness of
/// the object's texture.
fn cover(appearance: &Appearance, x: f32, y: f32, row: usize, col: usize) -> (f32, f32) {
    let place = |pixel: usize, sample: usize| {
        let offset = (sample as f32 + 0.5) / SAMPLES as f32;
        (pixel as f32 + offset) * 2.0 / PICTURE_SIZE as f32 - 1.0
    };
    let (mut share, mut brightness) = (0.0, 0.0);
    for (i, j) in (0..SAMPLES).flat_map(|i| (0..SAMPLES).map(move |j| (i, j))) {
        let u = (place(col, i) - x) / appearance.half_size;
        let v = (-place(row, j) - y) / appearance.half_size;
        if appearance.shape.contains(u, v) {
            share += 1.0;
            brightness += appearance.texture.brightness(u, v);
        }
    }
    let all = (SAMPLES * SAMPLES) as f32;
    (share / all, brightness / all)
}

/// Returns the random appearance of a piece of clutter: greyish and smaller than any object.
fn clutter(rng: &mut ChaCha8Rng) -> Appearance {
    let grey = rng.random_range(60.0..190.0);
    Appearance {
        colour: [0; 3].map(|_| grey + rng.random_range(-15.0..15.0)),
        shape: Shape::ALL[rng.random_range(0..2)],
        half_size: rng.random_range(0.04..0.09),
        texture: Texture::Plain,
        num_copies: 1,
    }
}

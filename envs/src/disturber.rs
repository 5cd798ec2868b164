//! Pictures as an imperfect camera and in-painting leave them.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::camera::{Camera, RGB, on_ring};
use crate::randomisation::Randomisation;
use crate::view::View;

/// Random streams of pictures; placements are drawn from those below, and stay as they are.
const PICTURES: u64 = 1 << 63;
/// Standard deviation of a patch's way from the gripper along either axis (mm): about the width of
/// an arm with its gripper.
const SPREAD: f64 = 100.0;
/// Levels are about this power of the light.
const GAMMA: f64 = 2.2;
/// The most of a pixel that one pass of the blur gives to either neighbour; more would leave it
/// less than they keep.
const SHARE: f64 = 0.25;

/// Levels of red, green and blue (of 255), and a number that fills a register.
type Pixel = [f32; RGB + 1];

/// The camera of one environment: what is wrong with it in the episode, and its random stream.
#[derive(Clone, Debug)]
pub(crate) struct Sight {
    rng: ChaCha8Rng,
    view: View,
    gains: [f32; RGB],
    /// Passes of the blur, and the share of a pixel that each gives to either neighbour.
    blur: (usize, f32),
}

impl Sight {
    /// A perfect camera of environment `index`; its stream is that of `seed`.
    pub fn new(seed: u64, index: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(PICTURES | index as u64);
        Self { rng, view: View::RIGHT, gains: [1.0; RGB], blur: (0, 0.0) }
    }
}

/// Makes a perfect camera's pictures those of a [`Sight`].
pub(crate) struct Disturber {
    amounts: Randomisation,
    camera: Camera,
    /// The picture on its way `[size, size]`, and room for the next step.
    levels: Vec<Pixel>,
    spare: Vec<Pixel>,
}

impl Disturber {
    /// For pictures of `camera`.
    pub fn new(amounts: Randomisation, camera: Camera) -> Self {
        let room = vec![Pixel::default(); camera.size * camera.size];
        Self { amounts, camera, levels: room.clone(), spare: room }
    }

    /// Draws what is wrong with a camera in the episode that begins.
    pub fn begin(&self, sight: &mut Sight) {
        let (amounts, rng) = (&self.amounts, &mut sight.rng);
        let position = vector(amounts.position_error / 1e3, rng);
        let turn = vector(amounts.angle_error.to_radians(), rng);
        let [exposure, red, blue] = normals(rng).map(f64::from);
        let light = |deviation| (amounts.exposure * exposure + amounts.balance * deviation) / 100.0;
        let blur = self.camera.pixels(rng.random::<f64>() * amounts.blur);
        sight.view = View::new(&self.camera, position, turn);
        sight.gains = [red, 0.0, blue].map(|of| (light(of) / GAMMA).exp() as f32);
        sight.blur = passes(blur * blur);
    }

    /// Makes `rgb` `[size, size, 3]`, the table as it is, a picture of the episode, with the mark
    /// over the gripper at `hand` (metres).
    pub fn disturb(&mut self, sight: &mut Sight, hand: DVec3, rgb: &mut [u8]) {
        self.look(&sight.view, rgb);
        for _ in 0..sight.blur.0 {
            self.blur(sight.blur.1);
        }
        self.patch(hand, &mut sight.rng);
        self.expose(sight.gains, &mut sight.rng, rgb);
        self.camera.draw_mark(&self.camera.mark, hand, rgb);
    }

    /// Takes the picture of a view, between pixels by the four around; its borders go on beyond.
    fn look(&mut self, view: &View, rgb: &[u8]) {
        for (out, rgb) in self.spare.iter_mut().zip(rgb.chunks_exact(RGB)) {
            *out = [rgb[0], rgb[1], rgb[2], 0].map(f32::from);
        }
        let size = self.camera.size;
        let (middle, last) = (size as f32 / 2.0 - 0.5, (size - 1) as f32);
        for (row, out) in self.levels.chunks_exact_mut(size).enumerate() {
            for (column, out) in out.iter_mut().enumerate() {
                let [x, y] = view.place([column as f32 - middle, middle - row as f32]);
                let (row, column) = (middle - y, middle + x);
                let (top, down) = split(row.clamp(0.0, last), size);
                let (left, across) = split(column.clamp(0.0, last), size);
                let start = top * size + left;
                let (above, below) = (&self.spare[start..][..2], &self.spare[start + size..][..2]);
                let [above, below] = [above, below].map(|two| between(two[0], two[1], across));
                *out = between(above, below, down);
            }
        }
    }

    /// Lets every pixel give `share` of itself to each of its neighbours, along rows and then along
    /// columns; what would go beyond the border stays.
    fn blur(&mut self, share: f32) {
        let size = self.camera.size;
        let lines = self.levels.chunks_exact(size);
        for (line, out) in lines.zip(self.spare.chunks_exact_mut(size)) {
            for (index, out) in out.iter_mut().enumerate() {
                let (before, behind) = neighbours(index, size);
                *out = mix(line[index], [line[before], line[behind]], share);
            }
        }
        let line = |index: usize| &self.spare[index * size..][..size];
        for (index, out) in self.levels.chunks_exact_mut(size).enumerate() {
            let (above, below) = neighbours(index, size);
            let around = line(above).iter().zip(line(below));
            for (out, (own, (above, below))) in out.iter_mut().zip(line(index).iter().zip(around)) {
                *out = mix(*own, [*above, *below], share);
            }
        }
    }

    /// Adds colours to discs around the gripper at `hand`.
    fn patch(&mut self, hand: DVec3, rng: &mut ChaCha8Rng) {
        let amounts = &self.amounts;
        let [right, up] = self.camera.project(hand);
        for _ in 0..rng.random_range(0..=amounts.patches) {
            let [x, y, _] = normals(rng).map(|aside| self.camera.pixels(SPREAD * f64::from(aside)));
            let offset = [right + x, y - up];
            let radius = self.camera.pixels(rng.random::<f64>() * amounts.patch_radius);
            let color = normals(rng).map(|off| amounts.patch_color as f32 * off);
            on_ring(offset, [radius, 0.0], self.camera.size, |pixel| {
                let levels = self.levels[pixel].iter_mut().zip(color);
                levels.for_each(|(level, color)| *level += color);
            });
        }
    }

    /// Reads the picture out: brighter by `gains`, and with noise.
    fn expose(&self, gains: [f32; RGB], rng: &mut ChaCha8Rng, rgb: &mut [u8]) {
        let deviation = self.amounts.noise as f32;
        let pixels = self.levels.iter().zip(rgb.chunks_exact_mut(RGB));
        for (levels, out) in pixels {
            let noise = normals(rng);
            for channel in 0..RGB {
                let level = levels[channel] * gains[channel] + deviation * noise[channel];
                // rounds, and stops at 0 and 255
                out[channel] = (level + 0.5) as u8;
            }
        }
    }
}

/// The pixel before a place on a line of so many, such that another follows, and how far the place
/// is behind it.
fn split(place: f32, size: usize) -> (usize, f32) {
    // an i32 takes less time than a usize, and a picture has no side that it cannot hold
    let before = (place as i32).min(size as i32 - 2);
    (before as usize, place - before as f32)
}

/// The indices beside one of `0..size`; itself where there is none.
fn neighbours(index: usize, size: usize) -> (usize, usize) {
    (index.saturating_sub(1), (index + 1).min(size - 1))
}

/// What a pixel is after it and the two beside it gave a `share` of themselves to either neighbour.
fn mix(own: Pixel, [before, behind]: [Pixel; 2], share: f32) -> Pixel {
    let of = |lane| own[lane] + share * (before[lane] - 2.0 * own[lane] + behind[lane]);
    std::array::from_fn(of)
}

/// The colour that lies this share of the way from one to another.
fn between(from: Pixel, to: Pixel, share: f32) -> Pixel {
    std::array::from_fn(|lane| from[lane] + (to[lane] - from[lane]) * share)
}

/// How often a picture is blurred for this variance (pixels squared) along either axis, and the
/// share that every pixel then gives to either neighbour: a pass adds twice the share.
fn passes(variance: f64) -> (usize, f32) {
    let passes = (variance / (2.0 * SHARE)).ceil();
    let share = variance / (2.0 * passes.max(1.0));
    (passes as usize, share as f32)
}

/// A vector of a length that is uniform up to `most`, all directions alike.
fn vector(most: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    let (sine, cosine) = rng.random_range(0.0..TAU).sin_cos();
    let across = (1.0 - z * z).sqrt();
    most * rng.random::<f64>() * DVec3::new(across * cosine, across * sine, z)
}

/// Numbers of mean 0 and variance 1, each the sum of three even numbers of 7 random bits: normal
/// ones but for their tails, which end at 2.98.
fn normals(rng: &mut ChaCha8Rng) -> [f32; RGB] {
    /// 1 over the root of 3 (128^2 - 1) / 12.
    const SCALE: f32 = 0.015_625_477;
    let bits: u64 = rng.random();
    let part = |index: usize| (bits >> (7 * index)) as i32 & 127;
    let sum = |channel| part(channel) + part(RGB + channel) + part(2 * RGB + channel);
    std::array::from_fn(|channel| (2 * sum(channel) - 3 * 127) as f32 * (0.5 * SCALE))
}

#[cfg(test)]
mod tests;

//! Domain randomisation: pictures with the errors of a real camera and of in-painting.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::camera::{Camera, RGB_CHANNELS, for_each_ring_pixel};
use crate::homography::Homography;
use crate::randomisation::VisualDomainRandomisation;

/// Number of the first random stream for camera errors of pictures. Placements use the streams
/// below it, so randomised pictures do not change them.
const PICTURE_STREAMS: u64 = 1 << 63;
/// Number of the first random stream for occlusion by the arm.
const OCCLUSION_STREAMS: u64 = PICTURE_STREAMS | 1 << 62;
/// Standard deviation of the distance of an off-colour patch from the gripper along either axis
/// (mm), about the width of an arm with its gripper.
const PATCH_SPREAD: f64 = 100.0;
/// Approximate exponent from the levels of a picture to linear light, as in sRGB.
const GAMMA: f64 = 2.2;
/// Largest share of a pixel that one blur pass gives to each neighbour. With more, the pixel would
/// keep less than its neighbours get.
const MAX_SHARE: f64 = 0.25;

/// Red, green and blue levels (of 255), padded to fill a SIMD register.
type Pixel = [f32; RGB_CHANNELS + 1];

/// Camera errors of one environment in its current episode, and its random stream.
#[derive(Clone, Debug)]
pub(crate) struct CameraErrors {
    rng: ChaCha8Rng,
    /// Stream of its own, so that occlusion does not change the other errors.
    occlusion_rng: ChaCha8Rng,
    view: Homography,
    gains: [f32; RGB_CHANNELS],
    /// Number of blur passes, and the share of a pixel that each pass gives to either neighbour.
    blur: (usize, f32),
}

impl CameraErrors {
    /// Creates a perfect camera for environment `index`, with its own random stream of `seed`.
    pub fn new(seed: u64, index: usize) -> Self {
        let stream = |first| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(first | index as u64);
            rng
        };
        let (rng, occlusion_rng) = (stream(PICTURE_STREAMS), stream(OCCLUSION_STREAMS));
        Self {
            rng,
            occlusion_rng,
            view: Homography::IDENTITY,
            gains: [1.0; RGB_CHANNELS],
            blur: (0, 0.0),
        }
    }

    /// Draws whether the arm hides objects in the episode that begins, which it does in the share
    /// `share` of the episodes.
    pub fn draw_occlusion(&mut self, share: f64) -> bool {
        self.occlusion_rng.random::<f64>() < share
    }
}

/// Randomiser that applies the errors of a [`CameraErrors`] to the pictures of a perfect camera.
pub(crate) struct VisualDomainRandomiser {
    amounts: VisualDomainRandomisation,
    camera: Camera,
    /// Pixels `[size, size]` of the picture that is being processed, and a second buffer for the
    /// next step.
    levels: Vec<Pixel>,
    spare: Vec<Pixel>,
}

impl VisualDomainRandomiser {
    /// Creates a randomiser for pictures of `camera`.
    pub fn new(amounts: VisualDomainRandomisation, camera: Camera) -> Self {
        let room = vec![Pixel::default(); camera.size * camera.size];
        Self { amounts, camera, levels: room.clone(), spare: room }
    }

    /// Draws random camera errors (pose, exposure, white balance, blur) for the episode that
    /// begins.
    pub fn begin_episode(&self, state: &mut CameraErrors) {
        let (amounts, rng) = (&self.amounts, &mut state.rng);
        // all numbers are drawn whatever the amounts, so that one amount does not shift the others'
        // draws
        let position = vector(amounts.max_position_error_mm / 1e3, rng);
        let turn = vector(amounts.max_angle_error_deg.to_radians(), rng);
        let [exposure, red, blue] = normals(rng).map(f64::from);
        let light = |deviation| {
            (amounts.exposure_sd * exposure + amounts.white_balance_sd * deviation) / 100.0
        };
        let blur = self.camera.millimetres_to_pixels(rng.random::<f64>() * amounts.max_blur_mm);
        state.view = Homography::new(&self.camera, position, turn);
        // green is the reference of the white balance; levels are light to the power 1 / GAMMA
        state.gains = [red, 0.0, blue].map(|of| (light(of) / GAMMA).exp() as f32);
        state.blur = passes(blur * blur);
    }

    /// Turns `rgb` `[size, size, 3]`, a perfect picture without mark, into a picture of the
    /// episode's camera, with the mark over the gripper at `hand` (metres).
    pub fn add_camera_errors(&mut self, state: &mut CameraErrors, hand: DVec3, rgb: &mut [u8]) {
        self.resample(&state.view, rgb);
        for _ in 0..state.blur.0 {
            self.blur(state.blur.1);
        }
        self.patch(hand, &mut state.rng);
        self.expose(state.gains, &mut state.rng, rgb);
        self.camera.draw_gripper_mark(&self.camera.mark, hand, rgb);
    }

    /// Resamples the picture `rgb` through a homography, with bilinear interpolation; border pixels
    /// extend outwards.
    fn resample(&mut self, view: &Homography, rgb: &[u8]) {
        for (out, color) in self.spare.iter_mut().zip(rgb.chunks_exact(RGB_CHANNELS)) {
            *out = [color[0], color[1], color[2], 0].map(f32::from);
        }
        let size = self.camera.size;
        let (middle, last) = (size as f32 / 2.0 - 0.5, (size - 1) as f32);
        for (row, out) in self.levels.chunks_exact_mut(size).enumerate() {
            for (column, target) in out.iter_mut().enumerate() {
                let [x, y] =
                    view.map_offset_to_nominal([column as f32 - middle, middle - row as f32]);
                let (source_row, source_column) = (middle - y, middle + x);
                let (top, down) = split(source_row.clamp(0.0, last), size);
                let (left, across) = split(source_column.clamp(0.0, last), size);
                let start = top * size + left;
                let (above, below) = (&self.spare[start..][..2], &self.spare[start + size..][..2]);
                let [above, below] = [above, below].map(|two| interpolate(two[0], two[1], across));
                *target = interpolate(above, below, down);
            }
        }
    }

    /// Blurs the picture once: each pixel gives `share` of itself to each neighbour, along rows and
    /// then along columns. Nothing is lost at the border.
    fn blur(&mut self, share: f32) {
        let size = self.camera.size;
        let lines = self.levels.chunks_exact(size);
        for (line, out) in lines.zip(self.spare.chunks_exact_mut(size)) {
            for (index, target) in out.iter_mut().enumerate() {
                let (before, behind) = neighbours(index, size);
                *target = blurred(line[index], [line[before], line[behind]], share);
            }
        }
        let line = |index: usize| &self.spare[index * size..][..size];
        for (index, out) in self.levels.chunks_exact_mut(size).enumerate() {
            let (above, below) = neighbours(index, size);
            let around = line(above).iter().zip(line(below));
            for (target, (own, (over, under))) in out.iter_mut().zip(line(index).iter().zip(around))
            {
                *target = blurred(*own, [*over, *under], share);
            }
        }
    }

    /// Draws off-colour patches, discs at random places around the gripper at `hand`, over the
    /// picture.
    fn patch(&mut self, hand: DVec3, rng: &mut ChaCha8Rng) {
        let amounts = &self.amounts;
        let [right, up] = self.camera.project(hand);
        for _ in 0..rng.random_range(0..=amounts.max_patches) {
            let [x, y, _] = normals(rng)
                .map(|aside| self.camera.millimetres_to_pixels(PATCH_SPREAD * f64::from(aside)));
            let offset = [right + x, y - up];
            let radius = self
                .camera
                .millimetres_to_pixels(rng.random::<f64>() * amounts.max_patch_radius_mm);
            let color = normals(rng).map(|off| amounts.patch_color_sd as f32 * off);
            for_each_ring_pixel(offset, [radius, 0.0], self.camera.size, |pixel| {
                let levels = self.levels[pixel].iter_mut().zip(color);
                levels.for_each(|(level, added)| *level += added);
            });
        }
    }

    /// Applies the channels' `gains` and noise to the picture, and writes it to `rgb` as bytes.
    fn expose(&self, gains: [f32; RGB_CHANNELS], rng: &mut ChaCha8Rng, rgb: &mut [u8]) {
        let deviation = self.amounts.noise_sd as f32;
        let pixels = self.levels.iter().zip(rgb.chunks_exact_mut(RGB_CHANNELS));
        for (levels, out) in pixels {
            let noise = normals(rng);
            for channel in 0..RGB_CHANNELS {
                let level = levels[channel] * gains[channel] + deviation * noise[channel];
                // the cast rounds, and saturates at 0 and 255
                out[channel] = (level + 0.5) as u8;
            }
        }
    }
}

/// Returns the index of the pixel before the coordinate `place` in a row or column of `size`
/// pixels, at most the last but one, and the distance from that pixel to `place`.
fn split(place: f32, size: usize) -> (usize, f32) {
    // converting to i32 is faster than to usize, and the side of a picture always fits
    let before = (place as i32).min(size as i32 - 2);
    (before as usize, place - before as f32)
}

/// Returns the indices of the two pixels next to a pixel in a row or column of `size`; at the
/// border that of the pixel itself.
fn neighbours(index: usize, size: usize) -> (usize, usize) {
    (index.saturating_sub(1), (index + 1).min(size - 1))
}

/// Returns a pixel after one blur pass, in which it and its two neighbours gave `share` to either
/// side.
fn blurred(own: Pixel, [before, behind]: [Pixel; 2], share: f32) -> Pixel {
    let of = |lane| own[lane] + share * (before[lane] - 2.0 * own[lane] + behind[lane]);
    std::array::from_fn(of)
}

/// Interpolates linearly between two colours.
fn interpolate(from: Pixel, to: Pixel, share: f32) -> Pixel {
    std::array::from_fn(|lane| from[lane] + (to[lane] - from[lane]) * share)
}

/// Returns the number of blur passes for a variance (pixels squared) along either axis, and the
/// share that each pixel gives to either neighbour. A pass adds twice the share to the variance.
fn passes(variance: f64) -> (usize, f32) {
    let passes = (variance / (2.0 * MAX_SHARE)).ceil();
    let share = variance / (2.0 * passes.max(1.0));
    (passes as usize, share as f32)
}

/// Returns a random vector of uniform direction, whose length is uniform in `[0, most]`.
fn vector(most: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    // the z of a uniform direction is uniform, by Archimedes' hat-box theorem
    let z: f64 = rng.random_range(-1.0..1.0);
    let (sine, cosine) = rng.random_range(0.0..TAU).sin_cos();
    let across = (1.0 - z * z).sqrt();
    most * rng.random::<f64>() * DVec3::new(across * cosine, across * sine, z)
}

/// Returns three random numbers of mean 0 and variance 1. Each is the sum of three uniform 7-bit
/// integers: close to normal, except that the tails end at 2.98.
fn normals(rng: &mut ChaCha8Rng) -> [f32; RGB_CHANNELS] {
    /// Reciprocal of the standard deviation of the sum, sqrt(3 (128^2 - 1) / 12).
    const SCALE: f32 = 0.015_625_477;
    let bits: u64 = rng.random();
    let part = |index: usize| (bits >> (7 * index)) as i32 & 127;
    let sum =
        |channel| part(channel) + part(RGB_CHANNELS + channel) + part(2 * RGB_CHANNELS + channel);
    // doubled, to subtract the mean of 3 * 63.5 in integers
    std::array::from_fn(|channel| (2 * sum(channel) - 3 * 127) as f32 * (0.5 * SCALE))
}

#[cfg(test)]
mod tests;

//! Simulated image sensor: exposure, noise, and the transfer function of sRGB.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Number of steps of linear light in the look-up table of sRGB levels. Fewer would lose dark
/// levels, where sRGB is steepest.
const STEPS: usize = 1 << 16;

/// Image sensor: sRGB's transfer function (IEC 61966-2-1) in both directions, and the collected
/// light.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sensor {
    /// Linear light of each of the 256 sRGB levels, in `[0, 1]`.
    light: Vec<f32>,
    /// Level in sRGB of each step of linear light.
    levels: Vec<u8>,
    /// Sums of the collected light, `[height, width, 3]`.
    collected: Vec<f32>,
    /// Number of pictures in the sums of light.
    count: f32,
}

impl Sensor {
    /// Creates a sensor with `pixels` pixels.
    pub(crate) fn new(pixels: usize) -> Self {
        let level = |step: usize| 255.0 * level(step as f64 / (STEPS - 1) as f64);
        Self {
            light: (0..256).map(|of| light(f64::from(of) / 255.0) as f32).collect(),
            levels: (0..STEPS).map(|step| level(step).round() as u8).collect(),
            collected: vec![0.0; 3 * pixels],
            count: 0.0,
        }
    }

    /// Adds the light of a picture `[height, width, 3]`; all pictures have equal weights.
    pub(crate) fn collect_light(&mut self, rgb: &[u8]) {
        for (sum, &level) in self.collected.iter_mut().zip(rgb) {
            *sum += self.light[usize::from(level)];
        }
        self.count += 1.0;
    }

    /// Writes the mean of the collected light, with gains and noise, to `rgb` as sRGB levels
    /// `[height, width, 3]`, and resets the sums.
    ///
    /// Light is multiplied by the gains of the channels, and gets noise of variance
    /// `shot * light + read^2`.
    pub(crate) fn read_out(
        &mut self,
        gains: [f64; 3],
        [shot, read]: [f64; 2],
        rng: &mut ChaCha8Rng,
        rgb: &mut [u8],
    ) {
        let gains = gains.map(|gain| gain as f32 / self.count);
        let (shot, read) = (shot as f32, (read * read) as f32);
        let noisy = shot > 0.0 || read > 0.0;
        let pixels = self.collected.chunks_exact_mut(3).zip(rgb.chunks_exact_mut(3));
        for (collected, levels) in pixels {
            for (channel, level) in levels.iter_mut().enumerate() {
                let mut light = gains[channel] * std::mem::take(&mut collected[channel]);
                if noisy {
                    light += (shot * light + read).sqrt() * standard_normal(rng);
                }
                let step = (light * (STEPS - 1) as f32 + 0.5).clamp(0.0, (STEPS - 1) as f32);
                *level = self.levels[step as usize];
            }
        }
        self.count = 0.0;
    }
}

/// Returns the linear light of an sRGB value, both in `[0, 1]`.
fn light(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Returns the sRGB value of linear light, both in `[0, 1]`.
fn level(light: f64) -> f64 {
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

/// Returns an approximately normal random number of mean 0 and variance 1: the sum of four uniform
/// numbers, with tails that end at 3.5.
pub(crate) fn standard_normal(rng: &mut ChaCha8Rng) -> f32 {
    /// Variance of the sum of four numbers that are uniform in 0..65536.
    const VARIANCE: f32 = 4.0 * (65536.0 * 65536.0 - 1.0) / 12.0;
    // one draw for all four, because every pixel of every picture needs three of these
    let bits: u64 = rng.random();
    let part = |shift: u32| bits >> shift & 0xffff;
    let sum: u64 = [0, 16, 32, 48].map(part).iter().sum();
    (sum as f32 - 2.0 * 65535.0) / VARIANCE.sqrt()
}

/// Returns a random unit vector, uniform over all directions.
pub(crate) fn random_direction(rng: &mut ChaCha8Rng) -> DVec3 {
    // the height of a uniform point on a sphere is uniform (Archimedes)
    let z: f64 = rng.random_range(-1.0..1.0);
    let (sine, cosine) = rng.random_range(0.0..TAU).sin_cos();
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * cosine, across * sine, z)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(1000)
    }

    /// Reads out the mean of uniformly grey pictures.
    fn seen(greys: &[u8], gains: [f64; 3], noise: [f64; 2], pixels: usize) -> Vec<u8> {
        let mut sensor = Sensor::new(pixels);
        for &grey in greys {
            sensor.collect_light(&vec![grey; 3 * pixels]);
        }
        let mut rgb = vec![0; 3 * pixels];
        sensor.read_out(gains, noise, &mut rng(), &mut rgb);
        rgb
    }

    #[test]
    fn a_perfect_sensor_returns_every_level_and_begins_anew() {
        let mut sensor = Sensor::new(256);
        let levels: Vec<u8> = (0..=255).flat_map(|level| [level; 3]).collect();
        for _ in 0..2 {
            sensor.collect_light(&levels);
            let mut rgb = vec![0; 768];
            sensor.read_out([1.0; 3], [0.0; 2], &mut rng(), &mut rgb);
            assert_eq!(rgb, levels);
        }
    }

    #[test]
    fn gains_multiply_light_and_stop_at_white() {
        let [red, green, blue] = seen(&[128], [0.5, 1.0, 9.0], [0.0; 2], 1)[..] else { panic!() };
        // half of the light of 128 / 255
        let half = 255.0 * level(0.5 * light(128.0 / 255.0));
        assert_eq!((f64::from(red), green, blue), (half.round(), 128, 255));
    }

    /// Motion blur is the mean of linear light: black and white give half of the white light.
    #[test]
    fn blur_is_the_mean_of_light() {
        let expected = (255.0 * level(0.5)).round() as u8;
        assert_eq!(seen(&[0, 255], [1.0; 3], [0.0; 2], 2), [expected; 6]);
        assert_eq!(expected, 188);
    }

    #[test]
    fn noise_has_the_variance_that_was_asked_for() {
        for (grey, noise) in [(128, [5e-4, 0.0]), (200, [5e-4, 1.5e-3]), (90, [0.0, 4e-3])] {
            let of = light(f64::from(grey) / 255.0);
            let lights = seen(&[grey], [1.0; 3], noise, 20_000).into_iter();
            let off: Vec<f64> = lights.map(|level| light(f64::from(level) / 255.0) - of).collect();
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            let variance = off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64;
            // the rounding of levels adds a twelfth of their distance squared
            let level = light(f64::from(grey + 1) / 255.0) - of;
            let expected = noise[0] * of + noise[1] * noise[1] + level * level / 12.0;
            assert!(mean.abs() < 0.03 * expected.sqrt(), "{grey}: {mean}");
            assert!((variance / expected - 1.0).abs() < 0.03, "{grey}: {variance} {expected}");
        }
    }

    #[test]
    fn a_middle_grey_is_three_levels_noisy() {
        let rgb = seen(&[128], [1.0; 3], [5e-4, 1.5e-3], 20_000);
        let squares = rgb.iter().map(|&level| (f64::from(level) - 128.0).powi(2));
        let deviation = (squares.sum::<f64>() / rgb.len() as f64).sqrt();
        assert!((2.5..3.5).contains(&deviation), "{deviation}");
    }

    #[test]
    fn numbers_have_mean_0_and_variance_1_and_directions_length_1() {
        let rng = &mut ChaCha8Rng::seed_from_u64(1000);
        let numbers: Vec<f64> = (0..100_000).map(|_| f64::from(standard_normal(rng))).collect();
        let mean = |power: i32| numbers.iter().map(|n| n.powi(power)).sum::<f64>() / 1e5;
        assert!(mean(1).abs() < 0.01 && mean(3).abs() < 0.03, "{} {}", mean(1), mean(3));
        assert!((mean(2) - 1.0).abs() < 0.01, "{}", mean(2));
        // 3 for a normal distribution; four uniform ones have 3 - 1.2 / 4
        assert!((mean(4) - 2.7).abs() < 0.05, "{}", mean(4));
        let sum: DVec3 = (0..10_000).map(|_| random_direction(rng)).sum();
        assert!(sum.length() < 200.0, "{sum}");
        assert!((random_direction(rng).length() - 1.0).abs() < 1e-12);
    }
}

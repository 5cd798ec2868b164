//! Image features from random convolution filters, pooled over positions and flips.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::error::{EvidenceError, Result};

/// Stride of the filters in rows and columns, in pixels.
const STRIDE: usize = 2;
/// Seed of the weights of the random filters: all banks of one size are equal.
const SEED: u64 = 0;

/// Fixed bank of random convolution filters, which describes the content of an image. Each filter
/// gives two features, averaged over the four flips of the filter: the mean over the image of the
/// responses above a noise floor, and the largest response. The floor is four times the lower
/// quartile of the magnitudes of the filter's responses to the same image, and at most a quarter of
/// the largest response. It keeps the camera's noise on plain ground out of the mean.
///
/// The features are equal for the four mirror images of an image, to the bit: pixels and weights
/// are integers, so sums are exact and do not depend on their order. Weights of each filter
/// sum to zero in each channel, so that uniform ground gives no response.
///
/// ```
/// use evidence::RandomFilters;
/// use symmetry::D2;
///
/// let filters = RandomFilters::new([12, 12, 3], 8)?;
/// let image: Vec<u8> = (0..12 * 12 * 3).map(|i| (i * i % 251) as u8).collect();
/// let features = filters.features(&image)?;
/// assert_eq!(features.len(), 16);
/// let mirrored = D2::FlipX.transform_image(&image, 12, 12, 3);
/// assert_eq!(filters.features(&mirrored)?, features);
/// # Ok::<(), evidence::EvidenceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct RandomFilters {
    image: [usize; 3],
    kernel: [usize; 2],
    count: usize,
    /// Weights of the four flips of each filter,
    /// `[kernel rows, kernel columns, channels, 4, filters]`.
    weights: Vec<f32>,
}

impl RandomFilters {
    /// Returns the shape of the images `[height, width, channels]`, and the number of filters.
    pub(crate) fn shape_and_count(&self) -> ([usize; 3], usize) {
        (self.image, self.count)
    }

    /// Creates the bank of `count` random filters for images `[height, width, channels]`, with the
    /// same weights in every call.
    ///
    /// # Errors
    /// Images smaller than 7 x 7, no channel or more than 1000, or no filter.
    pub fn new(image: [usize; 3], count: usize) -> Result<Self> {
        let [height, width, channels] = image;
        if height < 7 || width < 7 || !(1..=1000).contains(&channels) {
            return Err(EvidenceError::ImageSize { height, width, channels });
        }
        if count == 0 {
            return Err(EvidenceError::InvalidSetting {
                name: "filters",
                value: 0.0,
                expected: "at least 1",
            });
        }
        // an even side takes an even kernel and an odd side an odd one: with a stride of 2, the
        // positions of a filter are then mirror images of each other
        let kernel = [height, width].map(|size| if size.is_multiple_of(2) { 6 } else { 7 });
        Ok(Self { image, kernel, count, weights: weights(kernel, channels, count) })
    }

    /// Returns the features of an image `[height, width, channels]`: for each filter the mean of
    /// the responses above the noise floor, times 10, then the largest response of each, together
    /// scaled to Euclidean norm 1; zeros if no filter responds.
    ///
    /// # Errors
    /// An image of another size.
    pub fn features(&self, image: &[u8]) -> Result<Vec<f32>> {
        let expected = self.image.iter().product();
        if image.len() != expected {
            return Err(EvidenceError::Length { what: "an image", got: image.len(), expected });
        }
        let responses = self.responses(image);
        let mut features = vec![0.0; 2 * self.count];
        let (means, maxima) = features.split_at_mut(self.count);
        let unit = 4.0 * 255.0 * f64::from(max_weight(self.kernel, self.image[2]));
        for (filter, (mean, largest)) in means.iter_mut().zip(maxima).enumerate() {
            let places = responses.len() / (4 * self.count);
            let of_flip =
                |flip: usize| &responses[(flip * self.count + filter) * places..][..places];
            let (sum, peak) = pool(std::array::from_fn(of_flip));
            // a mean over all positions is small beside a peak, hence its weight
            *mean = (MEAN_WEIGHT * sum / (unit * places as f64)) as f32;
            *largest = (peak / unit) as f32;
        }
        normalise(&mut features);
        Ok(features)
    }

    /// Returns the responses of the four flips of all filters at all positions of an image,
    /// `[4, filters, positions]`.
    fn responses(&self, image: &[u8]) -> Vec<f32> {
        let taps = self.kernel[0] * self.kernel[1] * self.image[2];
        let patches = self.patches(image);
        let places = patches.len() / taps;
        let mut responses = vec![0.0; places * 4 * self.count];
        matmul(
            MatMut::from_column_major_slice_mut(&mut responses, places, 4 * self.count),
            Accum::Replace,
            MatRef::from_row_major_slice(&patches, places, taps),
            MatRef::from_row_major_slice(&self.weights, taps, 4 * self.count),
            1.0,
            Par::Seq,
        );
        responses
    }

    /// Returns the im2col matrix of an image, `[positions, taps]`.
    fn patches(&self, image: &[u8]) -> Vec<f32> {
        let [height, width, channels] = self.image;
        let [rows, cols] = self.kernel;
        let mut patches = Vec::new();
        for row in (0..=height - rows).step_by(STRIDE) {
            for col in (0..=width - cols).step_by(STRIDE) {
                for r in row..row + rows {
                    let from = (r * width + col) * channels;
                    let pixels = &image[from..from + cols * channels];
                    patches.extend(pixels.iter().map(|&p| f32::from(p)));
                }
            }
        }
        patches
    }
}

/// Noise floor of a filter as a multiple of the lower quartile of its responses' magnitudes.
// More than a quarter of the positions shows plain ground in most images, where a filter responds
// to the camera's noise alone. A tenth of the responses to Gaussian noise exceeds the floor.
// docs/assignment_figures.md compares other floors.
const NOISE_FLOOR: f32 = 4.0;
/// Largest noise floor as a share of the filter's largest response: texture that fills an image
/// stays above it.
const MAX_NOISE_FLOOR: f32 = 0.25;

/// Returns two sums over the four flips of a filter, from their responses `[positions]`: of the
/// responses above the noise floor, over all positions, and of each flip's largest response (at
/// least 0). In `f64` these sums of integers are exact.
fn pool(responses: [&[f32]; 4]) -> (f64, f64) {
    let largest = responses.map(|of_flip| of_flip.iter().copied().fold(0.0, f32::max));
    let magnitudes = responses.iter().flat_map(|of_flip| of_flip.iter().map(|r| r.abs()));
    let mut magnitudes: Vec<f32> = magnitudes.collect();
    let quarter = magnitudes.len() / 4;
    let quartile = *magnitudes.select_nth_unstable_by(quarter, f32::total_cmp).1;
    let bound = MAX_NOISE_FLOOR * largest.iter().copied().fold(0.0, f32::max);
    let floor = (NOISE_FLOOR * quartile).min(bound.floor());
    // from 0 at the floor to the whole response at twice the floor, so that strong ones keep theirs
    let above = |r: &f32| (2.0 * (r - floor)).min(*r).max(0.0);
    let sum = responses.iter().flat_map(|of_flip| *of_flip).map(|r| f64::from(above(r))).sum();
    (sum, largest.into_iter().map(f64::from).sum())
}

/// Weight of the mean filter responses relative to the largest ones in the features of an image.
const MEAN_WEIGHT: f64 = 10.0;

/// Returns the largest magnitude of a filter weight for which responses fit into the 24 bits of an
/// `f32`'s significand.
fn max_weight([rows, cols]: [usize; 2], channels: usize) -> i32 {
    let taps = (rows * cols * channels) as i32;
    ((1 << 24) / (255 * taps) / 2).clamp(1, 100)
}

/// Scales values to length 1.
fn normalise(values: &mut [f32]) {
    let squares = values.iter().map(|&v| f64::from(v).powi(2));
    let length = squares.sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    for value in values {
        *value = (f64::from(*value) / length) as f32;
    }
}

/// Returns uniformly random integer weights of `count` filters and their four flips,
/// `[rows, cols, channels, 4, count]`, shifted so that they sum to zero in each channel.
fn weights(kernel: [usize; 2], channels: usize, count: usize) -> Vec<f32> {
    let [rows, cols] = kernel;
    let (most, taps) = (max_weight(kernel, channels), rows * cols);
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut weights = vec![0.0; taps * channels * 4 * count];
    for filter in 0..count {
        let mut drawn: Vec<i32> =
            (0..taps * channels).map(|_| rng.random_range(-most..=most)).collect();
        for channel in 0..channels {
            centre(&mut drawn, channel, channels, taps as i32);
        }
        for (flip, g) in D2::ALL.into_iter().enumerate() {
            let moved = g.transform_image(&drawn, rows, cols, channels);
            for (tap, weight) in moved.into_iter().enumerate() {
                weights[(tap * 4 + flip) * count + filter] = weight as f32;
            }
        }
    }
    weights
}

/// Subtracts the mean from the weights of one filter in a channel; the first taps absorb the
/// remainder.
fn centre(drawn: &mut [i32], channel: usize, channels: usize, taps: i32) {
    let own = || (0..taps as usize).map(move |tap| tap * channels + channel);
    let sum: i32 = own().map(|at| drawn[at]).sum();
    let (each, mut rest) = (sum.div_euclid(taps), sum.rem_euclid(taps));
    for at in own() {
        drawn[at] -= each + i32::from(rest > 0);
        rest -= i32::from(rest > 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_whole_and_uniform_ground_gives_no_response() {
        for image in [[8, 9, 3], [48, 48, 6]] {
            let filters = RandomFilters::new(image, 5).unwrap();
            assert!(filters.weights.iter().all(|w| w.fract() == 0.0));
            let uniform = vec![200; image.iter().product()];
            assert!(filters.features(&uniform).unwrap().iter().all(|&v| v == 0.0));
        }
    }

    fn image_with_noise(
        noise: i16,
        rng: &mut ChaCha8Rng,
        level: impl Fn([usize; 3]) -> i16,
    ) -> Vec<u8> {
        let values = (0..48 * 48 * 3).map(|i| level([i / 144, i % 144 / 3, i % 3]));
        values.map(|value| (value + rng.random_range(-noise..=noise)) as u8).collect()
    }

    #[test]
    fn noise_hardly_changes_the_features_of_an_object_on_plain_ground() {
        let filters = RandomFilters::new([48, 48, 3], 32).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut features = |noise: i16, side: usize, colour: [i16; 3]| {
            let object = 10..10 + side;
            let level = |[row, col, channel]: [usize; 3]| {
                if object.contains(&row) && object.contains(&col) { colour[channel] } else { 120 }
            };
            filters.features(&image_with_noise(noise, &mut rng, level)).unwrap()
        };
        let distance = |a: &[f32], b: &[f32]| -> f32 {
            a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
        };
        for side in [10, 26] {
            let clean = features(0, side, [60, 140, 220]);
            let by_noise = distance(&features(20, side, [60, 140, 220]), &clean);
            let by_colour = distance(&features(0, side, [60, 220, 140]), &clean);
            assert!(by_noise < 0.5 * by_colour, "{side}: {by_noise} {by_colour}");
        }
    }

    #[test]
    fn texture_that_fills_the_image_stays_above_the_noise_floor() {
        let filters = RandomFilters::new([48, 48, 3], 8).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut means = |level: fn([usize; 3]) -> i16| {
            filters.features(&image_with_noise(0, &mut rng, level)).unwrap()[..8].to_vec()
        };
        let gradient = means(|[row, col, _]| (2 * row + col) as i16);
        let checkerboard = means(|[row, col, _]| 80 * ((row / 4 + col / 4) % 2) as i16);
        for found in [gradient, checkerboard] {
            assert!(found.iter().all(|mean| *mean > 0.0), "{found:?}");
        }
    }

    #[test]
    fn sizes_are_asked_for() {
        assert!(RandomFilters::new([6, 48, 3], 4).is_err());
        assert!(RandomFilters::new([48, 48, 0], 4).is_err());
        assert!(RandomFilters::new([48, 48, 3], 0).is_err());
        let message = RandomFilters::new([8, 8, 1], 4).unwrap().features(&[0; 3]).unwrap_err();
        assert_eq!(message.to_string(), "an image holds 3 values, expected 64");
    }
}

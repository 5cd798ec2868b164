//! Composition of observations from rendered pictures.

use glam::DVec3;

use super::{Camera, ExtraViews, RGB_CHANNELS};

/// Camera pictures that an observation's image is composed of, with the hand's position.
#[derive(Clone, Copy, Debug)]
pub struct ObservationPictures<'a> {
    /// Current picture with the gripper's mark `[size, size, 3]`.
    pub current: &'a [u8],
    /// First picture of the episode `[size, size, 3]`.
    pub first: &'a [u8],
    /// Rendered picture before downsampling and without the mark `[drawn_size, drawn_size, 3]`.
    pub rendered: &'a [u8],
    /// Position of the hand (metres).
    pub hand: DVec3,
}

/// Grey levels of a close-up beyond the picture's border, near the middle of the input range of
/// networks.
const BEYOND: [u8; RGB_CHANNELS] = [128; RGB_CHANNELS];

impl Camera {
    /// Returns the side of a picture as it is rendered, before downsampling (pixels).
    pub fn rendered_size(&self) -> usize {
        self.size * self.oversampling
    }

    /// Returns the camera with pictures of `size` pixels a side, no oversampling and no close-ups.
    pub fn with_size(self, size: usize) -> Self {
        Self { size, oversampling: 1, extra_views: ExtraViews::First, ..self }
    }

    /// Downsamples the rendered picture `rendered` `[rendered_size, rendered_size, 3]` to `rgb`
    /// `[size, size, 3]`. Means are rounded, halves up.
    pub fn downsample(&self, rendered: &[u8], rgb: &mut [u8]) {
        let factor = self.oversampling;
        if factor == 1 {
            rgb.copy_from_slice(rendered);
            return;
        }
        let line = self.rendered_size() * RGB_CHANNELS;
        let pixels = (factor * factor) as u32;
        let bands = rendered.chunks_exact(line * factor);
        for (band, out) in bands.zip(rgb.chunks_exact_mut(self.size * RGB_CHANNELS)) {
            for (column, pixel) in out.chunks_exact_mut(RGB_CHANNELS).enumerate() {
                // half a divisor, so that the integer division rounds
                let mut sums = [pixels / 2; RGB_CHANNELS];
                for row in band.chunks_exact(line) {
                    let block = &row[column * factor * RGB_CHANNELS..][..factor * RGB_CHANNELS];
                    for color in block.chunks_exact(RGB_CHANNELS) {
                        (0..RGB_CHANNELS)
                            .for_each(|channel| sums[channel] += u32::from(color[channel]));
                    }
                }
                pixel.copy_from_slice(&sums.map(|sum| (sum / pixels) as u8));
            }
        }
    }

    /// Composes an observation's image `[size, size, C]`: the current picture, then the extra
    /// views.
    ///
    /// # Panics
    /// If the image or a picture that is used has the wrong length.
    pub fn compose_observation<'a>(&self, pictures: &ObservationPictures<'a>, image: &mut [u8]) {
        let (pixels, channels) = (self.size * self.size, self.extra_views.num_total_channels());
        assert_eq!(image.len(), pixels * channels, "bytes of an image");
        let whole = |picture: &'a [u8]| {
            assert_eq!(picture.len(), pixels * RGB_CHANNELS, "bytes of a picture");
            picture.chunks_exact(RGB_CHANNELS)
        };
        let close_up = || self.close_up(pictures.rendered, pictures.hand);
        write_channels(image, channels, 0, whole(pictures.current));
        match self.extra_views {
            ExtraViews::First => {
                write_channels(image, channels, RGB_CHANNELS, whole(pictures.first))
            }
            ExtraViews::CloseUp => write_channels(image, channels, RGB_CHANNELS, close_up()),
            ExtraViews::FirstAndCloseUp => {
                write_channels(image, channels, RGB_CHANNELS, whole(pictures.first));
                write_channels(image, channels, 2 * RGB_CHANNELS, close_up());
            }
        }
    }

    /// Returns the pixels `[size, size]` of the part of `drawn` `[drawn_size, drawn_size, 3]`
    /// around the point of the table below `hand` (metres). The part is aligned to whole pixels, so
    /// a mirrored picture of a mirrored hand gives the mirrored part exactly.
    fn close_up<'a>(&self, drawn: &'a [u8], hand: DVec3) -> impl Iterator<Item = &'a [u8]> {
        let [right, up] = self.project(DVec3::new(hand.x, hand.y, 0.0));
        let (side, size) = (self.rendered_size() as i64, self.size as i64);
        // halves are rounded away from zero on either side, as exact mirror images need
        let start = [-up, right].map(|offset| {
            let pixels = offset * self.oversampling as f64;
            ((side - size) / 2).saturating_add(pixels.round() as i64)
        });
        // saturating sums above, so that a hand at infinity sees grey instead of overflowing
        let inside = move |place: i64| usize::try_from(place).ok().filter(|_| place < side);
        (0..size * size).map(move |index| {
            let [row, column] = [index / size, index % size];
            let row = inside(start[0].saturating_add(row));
            let column = inside(start[1].saturating_add(column));
            let place = row.zip(column).map(|(row, column)| row * side as usize + column);
            place.map_or(&BEYOND[..], |place| &drawn[place * RGB_CHANNELS..][..RGB_CHANNELS])
        })
    }
}

/// Writes the pixels of a picture into three channels of an image, from channel `place` on.
fn write_channels<'a>(
    image: &mut [u8],
    channels: usize,
    place: usize,
    pixels: impl Iterator<Item = &'a [u8]>,
) {
    for (out, pixel) in image.chunks_exact_mut(channels).zip(pixels) {
        out[place..][..RGB_CHANNELS].copy_from_slice(pixel);
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use symmetry::D2;

    use super::*;
    use crate::camera::OVERSAMPLING_RANGE;
    use crate::layout::map_point;

    const SIZE: usize = 4;

    fn camera(oversampling: usize) -> Camera {
        Camera { size: SIZE, oversampling, ..Camera::default() }
    }

    /// A picture without a symmetry.
    fn drawn(camera: &Camera) -> Vec<u8> {
        let length = camera.rendered_size() * camera.rendered_size() * RGB_CHANNELS;
        (0..length).map(|i| (i * 37 % 251) as u8).collect()
    }

    fn mirrored(rgb: &[u8], element: D2) -> Vec<u8> {
        let side = (rgb.len() / RGB_CHANNELS).isqrt();
        element.transform_image(rgb, side, side, RGB_CHANNELS)
    }

    fn cut(camera: &Camera, drawn: &[u8], hand: DVec3) -> Vec<u8> {
        let pixels = camera.close_up(drawn, hand);
        pixels.flatten().copied().collect()
    }

    #[test]
    fn a_picture_is_shrunk_to_the_means_of_its_squares() {
        let camera = camera(3);
        let drawn = drawn(&camera);
        let mut rgb = vec![0; SIZE * SIZE * RGB_CHANNELS];
        camera.downsample(&drawn, &mut rgb);
        for (index, &level) in rgb.iter().enumerate() {
            let (row, column) = (index / (SIZE * RGB_CHANNELS), index / RGB_CHANNELS % SIZE);
            let sum = (0..9).map(|i| {
                let (row, column) = (3 * row + i / 3, 3 * column + i % 3);
                f64::from(drawn[(row * 3 * SIZE + column) * RGB_CHANNELS + index % RGB_CHANNELS])
            });
            assert_eq!(f64::from(level), (sum.sum::<f64>() / 9.0).round(), "{index}");
        }
    }

    #[test]
    fn a_close_up_shows_what_is_under_the_hand_in_its_middle() {
        let camera = camera(2);
        let drawn = drawn(&camera);
        let metres = |pixels: f64| pixels * camera.half_extent / SIZE as f64;
        // two pixels of eight to the right and one up
        let hand = DVec3::new(metres(2.0), metres(1.0), 0.3);
        let expected = |row: usize, column: usize| {
            let inside = column + 2 + 2 < 8;
            if inside {
                &drawn[((row + 2 - 1) * 8 + column + 2 + 2) * RGB_CHANNELS..][..RGB_CHANNELS]
            } else {
                &BEYOND[..]
            }
        };
        let rgb = cut(&camera, &drawn, hand);
        for (pixel, color) in rgb.chunks_exact(RGB_CHANNELS).enumerate() {
            assert_eq!(color, expected(pixel / SIZE, pixel % SIZE), "{pixel}");
        }
    }

    #[test]
    #[should_panic(expected = "bytes of a picture")]
    fn a_picture_that_is_shown_must_be_whole() {
        let camera = camera(1);
        let drawn = drawn(&camera);
        let pictures = ObservationPictures {
            current: &drawn,
            first: &drawn[1..],
            rendered: &drawn,
            hand: DVec3::ZERO,
        };
        camera.compose_observation(&pictures, &mut [0; SIZE * SIZE * 2 * RGB_CHANNELS]);
    }

    #[test]
    fn a_hand_that_is_nowhere_near_sees_grey() {
        let camera = camera(2);
        for x in [9.0, -1e300, f64::INFINITY] {
            let rgb = cut(&camera, &drawn(&camera), DVec3::new(x, 0.0, 0.1));
            assert!(rgb.iter().all(|&level| level == BEYOND[0]), "{x}");
        }
    }

    #[test]
    fn both_pictures_of_a_mirrored_table_are_mirrored_to_the_bit() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        for element in (0..50).flat_map(|_| D2::ALL) {
            let camera = camera(rng.random_range(OVERSAMPLING_RANGE));
            let drawn = drawn(&camera);
            let moved = mirrored(&drawn, element);
            let hand = DVec3::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5), 0.1);
            let close = cut(&camera, &drawn, hand);
            let there = cut(&camera, &moved, map_point(element, hand));
            assert_eq!(mirrored(&close, element), there, "{element:?} {hand}");
            let [shrunk, moved] = [drawn, moved].map(|drawn| {
                let mut rgb = vec![0; SIZE * SIZE * RGB_CHANNELS];
                camera.downsample(&drawn, &mut rgb);
                rgb
            });
            assert_eq!(mirrored(&shrunk, element), moved, "{element:?}");
        }
    }
}

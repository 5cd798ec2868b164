//! Image warp with bilinear interpolation.

use crate::error::{InpaintingError, check_picture_size};

/// Number of steps between two pixels in the bilinear interpolation: two weights of 8 bits and a
/// level fit into 32 bits.
const PARTS: f64 = 256.0;
/// Largest distance (pixels) of a point beyond the outermost pixel middles that counts as rounding.
const ROUNDING: f64 = 1e-6;

/// Map from one picture to another: each pixel is interpolated between four pixels of the source.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Warp {
    taps: Vec<Tap>,
    width: usize,
    height: usize,
}

/// Source of a pixel of the warped picture: the upper left of four pixels, and the weights of the
/// right column and of the lower row, in parts of [`PARTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tap {
    pixel: u32,
    right: u16,
    below: u16,
}

impl Warp {
    /// Creates a warp from a picture of `width` x `height` pixels, at least 2 x 2. `places` are
    /// column and row (pixels; the middle of the first one is at 0.5) for each pixel of the result.
    ///
    /// # Errors
    /// [`InpaintingError::OutOfSight`] for a place outside of the picture.
    pub(crate) fn new(
        [width, height]: [usize; 2],
        places: impl Iterator<Item = Option<[f64; 2]>>,
    ) -> Result<Self, InpaintingError> {
        let tap = |place: Option<[f64; 2]>| {
            let [column, row] = place.unwrap_or([f64::NAN; 2]);
            let (left, right) = split(column, width)?;
            let (above, below) = split(row, height)?;
            let pixel = (above * width + left) as u32;
            Some(Tap { pixel, right, below })
        };
        let tap = |place| tap(place).ok_or(InpaintingError::OutOfSight { place, width, height });
        let taps = places.map(tap).collect::<Result<_, _>>()?;
        Ok(Self { taps, width, height })
    }

    /// Warps the picture `from` into `to`, which has one pixel for each place of the map.
    ///
    /// # Errors
    /// [`InpaintingError::WrongLength`].
    pub(crate) fn apply(&self, from: &[u8], to: &mut [u8]) -> Result<(), InpaintingError> {
        check_picture_size("picture", from, self.width * self.height)?;
        check_picture_size("result", to, self.taps.len())?;
        let line = 3 * self.width;
        for (tap, pixel) in self.taps.iter().zip(to.chunks_exact_mut(3)) {
            let corner = &from[3 * tap.pixel as usize..][..line + 6];
            let (right, below) = (u32::from(tap.right), u32::from(tap.below));
            let (left, above) = (PARTS as u32 - right, PARTS as u32 - below);
            for (channel, value) in pixel.iter_mut().enumerate() {
                let at = |place: usize| u32::from(corner[place + channel]);
                let upper = left * at(0) + right * at(3);
                let lower = left * at(line) + right * at(line + 3);
                *value = ((above * upper + below * lower + (1 << 15)) >> 16) as u8;
            }
        }
        Ok(())
    }
}

/// Splits a coordinate along one side of the picture into the index of the pixel before it and the
/// weight of the next one; `None` if it is outside of the picture.
fn split(place: f64, count: usize) -> Option<(usize, u16)> {
    let from_first = place - 0.5;
    let last = count as f64 - 1.0;
    let shown = from_first >= -ROUNDING && from_first <= last + ROUNDING;
    let from_first = shown.then_some(from_first.clamp(0.0, last))?;
    // at the last middle the pair ends there, with the weight 1 of the last pixel
    let pixel = from_first.min(last - 1.0).floor();
    Some((pixel as usize, ((from_first - pixel) * PARTS).round() as u16))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [5, 4];

    fn picture() -> Vec<u8> {
        (0..3 * 20_u32).map(|i| (i * 97 % 256) as u8).collect()
    }

    fn middles() -> impl Iterator<Item = [f64; 2]> {
        (0..20).map(|i| [(i % 5) as f64 + 0.5, (i / 5) as f64 + 0.5])
    }

    #[test]
    fn a_picture_taken_from_its_own_middles_is_the_same() {
        for nudge in [0.0, 1e-9, -1e-9] {
            let places = middles().map(|[column, row]| Some([column + nudge, row - nudge]));
            let warp = Warp::new(SIZE, places).unwrap();
            let mut result = vec![0; 60];
            warp.apply(&picture(), &mut result).unwrap();
            assert_eq!(result, picture());
        }
    }

    #[test]
    fn half_way_between_pixels_is_their_mean() {
        let from = picture();
        let warp = Warp::new(SIZE, [Some([2.0, 3.0])].into_iter()).unwrap();
        let mut result = [0; 3];
        warp.apply(&from, &mut result).unwrap();
        for (channel, value) in result.into_iter().enumerate() {
            // between columns 1 and 2, rows 2 and 3
            let of = |pixel: usize| f64::from(from[3 * pixel + channel]);
            let mean = (of(11) + of(12) + of(16) + of(17)) / 4.0;
            assert!((f64::from(value) - mean).abs() <= 0.5, "{value} {mean}");
        }
    }

    #[test]
    fn places_outside_of_the_picture_and_wrong_lengths_are_refused() {
        for place in [Some([0.4, 2.0]), Some([2.0, 3.6]), Some([f64::NAN; 2]), None] {
            let message = Warp::new(SIZE, [place].into_iter()).unwrap_err().to_string();
            assert!(message.contains("5 x 4"), "{message}");
        }
        let warp = Warp::new(SIZE, middles().map(Some)).unwrap();
        let message = warp.apply(&[0; 59], &mut [0; 60]).unwrap_err().to_string();
        assert!(message.contains("59 elements, expected 60"), "{message}");
        assert!(warp.apply(&[0; 60], &mut [0; 57]).is_err());
    }
}

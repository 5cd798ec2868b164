//! The group D2 and its actions on points, pixels and images.

use std::fmt;
use std::ops::Mul;

use serde::{Deserialize, Serialize};

/// Element of D2, the symmetry group of a rectangle centred on the origin.
///
/// It has two bits: bit 0 flips x, bit 1 flips y. The product is the xor of the bits, so the group
/// is commutative and every element is its own inverse. Files hold the name that
/// [`Display`](fmt::Display) prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum D2 {
    /// Element that leaves every point in place.
    #[serde(rename = "identity")]
    Identity,
    /// Flip that maps (x, y) to (-x, y).
    #[serde(rename = "flip x")]
    FlipX,
    /// Flip that maps (x, y) to (x, -y).
    #[serde(rename = "flip y")]
    FlipY,
    /// Half turn that maps (x, y) to (-x, -y).
    #[serde(rename = "half turn")]
    HalfTurn,
}

impl D2 {
    /// All four elements of D2, in the order of their bits.
    pub const ALL: [D2; 4] = [D2::Identity, D2::FlipX, D2::FlipY, D2::HalfTurn];

    /// Returns the group element as two bits, in 0..4: bit 0 flips x, bit 1 flips y.
    pub const fn bits(self) -> usize {
        self as usize
    }

    /// Returns the element of D2 with the two lowest bits of `bits`; higher bits are ignored.
    pub const fn from_bits(bits: usize) -> D2 {
        Self::ALL[bits & 3]
    }

    /// Returns `true` if the group element maps x to -x.
    pub const fn flips_x(self) -> bool {
        self.bits() & 1 != 0
    }

    /// Returns `true` if the group element maps y to -y.
    pub const fn flips_y(self) -> bool {
        self.bits() & 2 != 0
    }

    /// Returns the point to which the group element moves the point (x, y), both relative to the
    /// centre and in any unit of length.
    pub fn apply_xy(self, [x, y]: [f64; 2]) -> [f64; 2] {
        [if self.flips_x() { -x } else { x }, if self.flips_y() { -y } else { y }]
    }

    /// Returns the row and column to which the element moves a pixel of a `height` x `width` image.
    ///
    /// # Panics
    /// If the pixel lies outside the image.
    pub fn apply_pixel(
        self,
        row: usize,
        col: usize,
        height: usize,
        width: usize,
    ) -> (usize, usize) {
        assert!(
            row < height && col < width,
            "pixel ({row}, {col}) lies outside a {height} x {width} image"
        );
        (
            if self.flips_y() { height - 1 - row } else { row },
            if self.flips_x() { width - 1 - col } else { col },
        )
    }

    /// Returns a channels-last image `[height, width, channels]` transformed by the element.
    ///
    /// Only pixels move; [`FieldType::transform_channels`](crate::FieldType::transform_channels)
    /// changes the signs of channels.
    ///
    /// # Panics
    /// If `image` does not hold height x width x channels values.
    pub fn transform_image<T: Copy>(
        self,
        image: &[T],
        height: usize,
        width: usize,
        channels: usize,
    ) -> Vec<T> {
        assert_eq!(
            image.len(),
            height * width * channels,
            "the image's length is not {height} x {width} x {channels}"
        );
        let len = width * channels;
        // source index of each value of a flipped row: one gather is faster than a copy per pixel
        let mirrored: Vec<usize> =
            (0..len).map(|i| (width - 1 - i / channels) * channels + i % channels).collect();
        let mut out = Vec::with_capacity(image.len());
        for row in 0..height {
            let row = if self.flips_y() { height - 1 - row } else { row };
            let from = &image[row * len..][..len];
            if self.flips_x() {
                out.extend(mirrored.iter().map(|&i| from[i]));
            } else {
                out.extend_from_slice(from);
            }
        }
        out
    }
}

/// Returns the bits of the product of two elements of D2, or of two of its irreps, from the bits of
/// both: their exclusive or.
pub(crate) fn product(a: usize, b: usize) -> usize {
    a ^ b
}

impl Mul for D2 {
    type Output = D2;

    fn mul(self, other: D2) -> D2 {
        D2::from_bits(product(self.bits(), other.bits()))
    }
}

impl fmt::Display for D2 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            D2::Identity => "identity",
            D2::FlipX => "flip x",
            D2::FlipY => "flip y",
            D2::HalfTurn => "half turn",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_is_that_of_the_maps_on_points() {
        for g in D2::ALL {
            for h in D2::ALL {
                let p = [0.3, -0.7];
                assert_eq!((g * h).apply_xy(p), g.apply_xy(h.apply_xy(p)));
            }
            assert_eq!(g * g, D2::Identity);
            assert_eq!(D2::from_bits(g.bits()), g);
        }
    }

    #[test]
    fn files_hold_the_printed_names() {
        for g in D2::ALL {
            let text = serde_json::to_string(&g).unwrap();
            assert_eq!(text, format!("\"{g}\""));
            assert_eq!(serde_json::from_str::<D2>(&text).unwrap(), g);
        }
        assert!(serde_json::from_str::<D2>("\"flip z\"").is_err());
    }

    #[test]
    fn pixels_follow_points() {
        let (height, width) = (5, 4);
        let to_xy = |row: usize, col: usize| {
            [col as f64 - (width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0 - row as f64]
        };
        for g in D2::ALL {
            for row in 0..height {
                for col in 0..width {
                    let (r, c) = g.apply_pixel(row, col, height, width);
                    assert_eq!(to_xy(r, c), g.apply_xy(to_xy(row, col)), "{g}");
                }
            }
        }
    }

    #[test]
    fn flip_x_mirrors_the_columns_of_an_image() {
        let image = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
        let flipped = D2::FlipX.transform_image(&image, 2, 3, 2);
        assert_eq!(flipped, [5, 6, 3, 4, 1, 2, 11, 12, 9, 10, 7, 8]);
        let up = D2::FlipY.transform_image(&image, 2, 3, 2);
        assert_eq!(up, [7, 8, 9, 10, 11, 12, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    #[should_panic(expected = "not 2 x 2 x 3")]
    fn an_image_of_the_wrong_length_is_refused() {
        D2::FlipX.transform_image(&[0u8; 11], 2, 2, 3);
    }

    #[test]
    #[should_panic(expected = "pixel (2, 0) lies outside a 2 x 3 image")]
    fn a_pixel_outside_the_image_is_refused() {
        D2::FlipY.apply_pixel(2, 0, 2, 3);
    }
}

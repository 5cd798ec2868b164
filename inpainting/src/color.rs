//! Colour correction: maps a picture under other light to the colours of a reference.

use glam::{DMat3, DVec3};

/// Method that maps the colours of a picture to those of a reference, fitted to the pixels that
/// both show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorCorrection {
    /// No correction.
    None,
    /// Matches mean and standard deviation of each channel of the decorrelated space l, alpha, beta
    /// (Reinhard, Ashikhmin, Gooch, Shirley, "Color Transfer between Images", IEEE
    /// CG&A 21(5), 2001).
    #[default]
    MeanAndDeviation,
    /// Scales red, green and blue so that both pictures have one mean (grey world, von Kries).
    GreyWorld,
}

/// Largest differences (levels) between corrected pixels and the reference that the successive fits
/// of a colour correction include. Pixels that differ by more show something that moved.
const INLIER_LEVELS: [f64; 3] = [24.0, 6.0, 2.0];

/// Affine map of each colour channel, in the colour space of a correction:
/// `(value - from) * gain + to`.
#[derive(Clone, Copy, Debug)]
struct Map {
    correction: ColorCorrection,
    from: DVec3,
    gain: DVec3,
    to: DVec3,
}

impl ColorCorrection {
    /// Corrects the picture `rgb` `[height, width, 3]` in place to the colours of `reference`, of
    /// the same shape.
    ///
    /// The fit leaves out the pixels that are `true` in `mask` `[height, width]`, and those that
    /// show something that moved.
    pub(crate) fn apply(self, reference: &[u8], mask: &[bool], rgb: &mut [u8]) {
        if self == Self::None {
            return;
        }
        let Some(map) = self.fit(reference, mask, rgb) else {
            return;
        };
        for pixel in rgb.chunks_exact_mut(3) {
            let corrected = map.apply(color(pixel)).to_array();
            pixel.copy_from_slice(&corrected.map(|value| value.round() as u8));
        }
    }

    /// Fits the colour map to the pixels that are not hidden and show nothing that moved; `None` if
    /// all are hidden.
    fn fit(self, reference: &[u8], mask: &[bool], rgb: &[u8]) -> Option<Map> {
        let pixels = rgb.chunks_exact(3).zip(reference.chunks_exact(3)).zip(mask);
        let shown = pixels.filter(|(_, hidden)| !**hidden).map(|(pair, _)| pair);
        // the first fit includes what moved, so only its means are used
        let mut map = Map::fit(self, shown.clone())?.of_means();
        for tolerance in INLIER_LEVELS {
            let still = shown.clone().filter(|(now, before)| {
                let difference = map.apply(color(now)) - color(before);
                difference.abs().max_element() <= tolerance
            });
            // with no pixel left, the last map stands
            map = Map::fit(self, still).unwrap_or(map);
        }
        Some(map)
    }

    /// Converts RGB levels to the colour space of the correction.
    fn space(self, rgb: DVec3) -> DVec3 {
        match self {
            Self::MeanAndDeviation => lab(rgb),
            Self::None | Self::GreyWorld => rgb,
        }
    }

    /// Converts a value in the colour space of the correction back to RGB levels.
    fn rgb(self, value: DVec3) -> DVec3 {
        match self {
            Self::MeanAndDeviation => from_lab(value),
            Self::None | Self::GreyWorld => value,
        }
    }
}

impl Map {
    /// Fits the colour map from the pixels of a picture to those of the reference; `None` without
    /// pixels.
    fn fit<'a>(
        correction: ColorCorrection,
        pairs: impl Iterator<Item = (&'a [u8], &'a [u8])>,
    ) -> Option<Self> {
        let (mut now, mut reference) = (Moments::default(), Moments::default());
        for (a, b) in pairs {
            now.add(correction.space(color(a)));
            reference.add(correction.space(color(b)));
        }
        (now.count > 0.0).then(|| Self::between(correction, &now, &reference))
    }

    fn between(correction: ColorCorrection, now: &Moments, reference: &Moments) -> Self {
        let (from, to) = (now.mean(), reference.mean());
        let (from, gain, to) = match correction {
            ColorCorrection::GreyWorld => (DVec3::ZERO, ratio(to, from), DVec3::ZERO),
            _ => (from, spread_ratio(reference, now), to),
        };
        Self { correction, from, gain, to }
    }

    /// Returns the colour map without gains from standard deviations, which moving objects can
    /// dominate.
    fn of_means(mut self) -> Self {
        if self.correction == ColorCorrection::MeanAndDeviation {
            self.gain = DVec3::ONE;
        }
        self
    }

    fn apply(&self, rgb: DVec3) -> DVec3 {
        let moved = (self.correction.space(rgb) - self.from) * self.gain + self.to;
        let full = DVec3::splat(255.0);
        self.correction.rgb(moved).clamp(DVec3::ZERO, full)
    }
}

/// Running mean and variance of the colours of pixels, channel by channel.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    count: f64,
    sum: DVec3,
    first: DVec3,
    /// Sums of the squared offsets from the first pixel. Squares of the values themselves would
    /// lose all digits to cancellation if the picture hardly varies.
    squares: DVec3,
}

impl Moments {
    fn add(&mut self, value: DVec3) {
        if self.count == 0.0 {
            self.first = value;
        }
        let offset = value - self.first;
        self.count += 1.0;
        self.sum += value;
        self.squares += offset * offset;
    }

    fn mean(&self) -> DVec3 {
        self.sum / self.count
    }

    fn deviation(&self) -> DVec3 {
        let offset = self.mean() - self.first;
        let variance = self.squares / self.count - offset * offset;
        variance.max(DVec3::ZERO).map(f64::sqrt)
    }
}

/// Returns the quotient of two colours, channel by channel; 1 where the divisor is not positive.
fn ratio(above: DVec3, below: DVec3) -> DVec3 {
    DVec3::select(below.cmpgt(DVec3::ZERO), above / below, DVec3::ONE)
}

/// Returns the ratio of the standard deviations of two pictures in l, alpha, beta; 1 in a channel
/// in which either picture varies by no more than the rounding of its levels.
fn spread_ratio(above: &Moments, below: &Moments) -> DVec3 {
    let varies = |moments: &Moments| moments.deviation().cmpgt(rounding(moments.mean()));
    let ratio = above.deviation() / below.deviation();
    DVec3::select(varies(above) & varies(below), ratio, DVec3::ONE)
}

/// Returns the largest change in l, alpha, beta by half a level of each of red, green and blue.
fn rounding(lab: DVec3) -> DVec3 {
    // the derivative of a logarithm is the reciprocal
    let cones = (AXES.inverse() * lab).map(f64::exp);
    AXES.abs() * (0.5 / cones)
}

fn color(pixel: &[u8]) -> DVec3 {
    DVec3::new(pixel[0].into(), pixel[1].into(), pixel[2].into())
}

/// Matrix from linear RGB to the responses of the eye's cones (Reinhard et al., equation 4).
const LMS: DMat3 = DMat3::from_cols_array_2d(&[
    [0.3811, 0.1967, 0.0241],
    [0.5783, 0.7244, 0.1288],
    [0.0402, 0.0782, 0.8444],
]);

/// Matrix from the logarithms of the cones' responses to decorrelated axes (Reinhard et al.,
/// equation 6), without the scaling of each axis, which a gain per axis would undo.
const AXES: DMat3 =
    DMat3::from_cols_array_2d(&[[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -2.0, 0.0]]);

/// Converts levels of RGB to l, alpha, beta.
fn lab(rgb: DVec3) -> DVec3 {
    // the logarithm of 0 is not finite; 0.3 still rounds to black
    let cones = (LMS * rgb).max(DVec3::splat(0.3)).map(f64::ln);
    AXES * cones
}

/// Converts l, alpha, beta to levels of RGB.
fn from_lab(lab: DVec3) -> DVec3 {
    LMS.inverse() * (AXES.inverse() * lab).map(f64::exp)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of many colours.
    fn picture() -> Vec<u8> {
        (0..40 * 40_u32)
            .flat_map(|i| [30 + i % 150, 40 + (i * 7) % 130, 50 + (i * 13) % 110].map(|v| v as u8))
            .collect()
    }

    /// Returns the picture under warmer, darker light.
    fn relit(picture: &[u8]) -> Vec<u8> {
        let gains = [0.95, 0.8, 0.6].into_iter().cycle();
        let pixels = picture.iter().zip(gains);
        pixels.map(|(&v, gain)| (f64::from(v) * gain).round() as u8).collect()
    }

    fn worst(a: &[u8], b: &[u8]) -> u8 {
        a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
    }

    const BOTH: [ColorCorrection; 2] =
        [ColorCorrection::MeanAndDeviation, ColorCorrection::GreyWorld];

    #[test]
    fn a_picture_under_the_same_light_stays_as_it_is_to_the_bit() {
        let reference = picture();
        for correction in BOTH {
            let mut rgb = reference.clone();
            correction.apply(&reference, &vec![false; 1600], &mut rgb);
            assert!(rgb == reference, "{correction:?}");
        }
    }

    #[test]
    fn other_light_is_corrected_and_none_does_nothing() {
        let reference = picture();
        let dim = relit(&reference);
        assert!(worst(&dim, &reference) > 50);
        for (correction, tolerance) in BOTH.into_iter().zip([12, 2]) {
            let mut rgb = dim.clone();
            correction.apply(&reference, &vec![false; 1600], &mut rgb);
            let worst = worst(&rgb, &reference);
            assert!(worst <= tolerance, "{correction:?}: {worst}");
        }
        let mut rgb = dim.clone();
        ColorCorrection::None.apply(&reference, &vec![false; 1600], &mut rgb);
        assert!(rgb == dim);
    }

    /// Tables without colour: one of many greys, and one that is grey all over.
    fn grey_pictures() -> [Vec<u8>; 2] {
        let textured = (0..1600_u32).flat_map(|i| [(90 + (i * 7) % 60) as u8; 3]);
        [textured.collect(), vec![120; 3 * 1600]]
    }

    /// Deviations carry no information on the light if the reference has no colour.
    #[test]
    fn a_coloured_thing_that_moves_over_a_grey_table_does_not_count() {
        for reference in grey_pictures() {
            let mut rgb = reference.clone();
            for i in 400..500 {
                rgb[3 * i..][..3].copy_from_slice(&[200, 40, 60]);
            }
            for correction in BOTH {
                let mut corrected = rgb.clone();
                correction.apply(&reference, &[false; 1600], &mut corrected);
                assert!(corrected == rgb, "{correction:?}: the light is the same");
            }
            let dim: Vec<u8> = rgb.iter().map(|&v| (f64::from(v) * 0.7).round() as u8).collect();
            for correction in BOTH {
                let mut corrected = dim.clone();
                correction.apply(&reference, &[false; 1600], &mut corrected);
                let worst = worst(&corrected, &rgb);
                assert!(worst <= 3, "{correction:?}: {worst}");
            }
        }
    }

    #[test]
    fn the_deviation_of_what_hardly_varies_is_exact() {
        let mut moments = Moments::default();
        for i in 0..1000 {
            moments.add(DVec3::splat(if i % 2 == 0 { 1e6 } else { 1e6 + 2e-6 }));
        }
        let off = (moments.deviation() - 1e-6).abs().max_element();
        assert!(off < 1e-7, "{off}");
        let mut uniform = Moments::default();
        (0..1000).for_each(|_| uniform.add(DVec3::splat(0.1)));
        assert!(uniform.deviation().max_element() < 1e-15);
    }

    /// Pixels that are hidden or moved do not affect the fit.
    #[test]
    fn hidden_and_moved_pixels_do_not_count() {
        let reference = picture();
        let mut rgb = reference.clone();
        let mut mask = vec![false; 1600];
        for i in 0..400 {
            rgb[3 * i..][..3].copy_from_slice(&[255, 0, 0]);
            mask[i] = true;
        }
        for i in 400..500 {
            rgb[3 * i..][..3].copy_from_slice(&[0, 255, 255]);
        }
        for correction in BOTH {
            let mut corrected = rgb.clone();
            correction.apply(&reference, &mask, &mut corrected);
            assert!(corrected[1500..] == reference[1500..], "{correction:?}");
        }
        let mut all_hidden = rgb.clone();
        ColorCorrection::GreyWorld.apply(&reference, &vec![true; 1600], &mut all_hidden);
        assert!(all_hidden == rgb);
    }
}

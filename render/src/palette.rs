//! Quantisation of a film's colours: one palette for all pictures, so that colours do not shimmer.

use std::collections::HashMap;

/// Colour of a pixel: levels of red, green and blue.
type Rgb = [u8; 3];

/// Palette of at most 255 colours, with the index of the one that replaces each colour of a film.
///
/// The colours are split as in P. Heckbert's median cut ("Color image quantization for frame buffer
/// display", SIGGRAPH 1982, section 4.2), but the set with the largest sum of squared distances
/// from its mean is cut next, and at its mean: a small mark in a colour of its own keeps that
/// colour.
pub(super) struct Palette {
    colours: Vec<Rgb>,
    index: HashMap<Rgb, u8>,
}

impl Palette {
    /// Maximum number of colours of the palette; the index after them marks unchanged pixels.
    pub const MAX_COLOURS: usize = 255;

    /// Chooses the palette of a film from its pictures, each RGB bytes `[.., 3]`.
    pub fn from_pictures<'a>(pictures: impl IntoIterator<Item = &'a [u8]>) -> Self {
        let mut counts: HashMap<Rgb, u32> = HashMap::new();
        for picture in pictures {
            let (pixels, _) = picture.as_chunks();
            for &rgb in pixels {
                *counts.entry(rgb).or_default() += 1;
            }
        }
        let mut pixels: Vec<(Rgb, u32)> = counts.into_iter().collect();
        // the order of a hash map is random, and sums depend on the order
        pixels.sort_unstable();
        let mut sets = vec![Set::of(pixels)];
        while sets.len() < Self::MAX_COLOURS
            && let Some(widest) = widest(&sets)
        {
            let [low, high] = sets.swap_remove(widest).cut();
            sets.extend([low, high]);
        }
        let mut palette =
            Self { colours: sets.iter().map(Set::colour).collect(), index: HashMap::new() };
        for (number, set) in sets.iter().enumerate() {
            let members = set.pixels.iter().map(|&(rgb, _)| (rgb, number as u8));
            palette.index.extend(members);
        }
        palette
    }

    /// Returns the red, green and blue levels of the palette's colours, one colour after the other.
    pub fn rgb_bytes(&self) -> Vec<u8> {
        self.colours.concat()
    }

    /// Returns the index of each pixel's colour, for one of the pictures of
    /// [`Palette::from_pictures`].
    pub fn indices(&self, picture: &[u8]) -> Vec<u8> {
        let (pixels, _) = picture.as_chunks();
        let index = |rgb| self.index.get(rgb).copied().unwrap_or_default();
        pixels.iter().map(index).collect()
    }
}

/// Set of the film's colours that share one colour of the palette.
struct Set {
    /// Colours of the set with the number of their pixels.
    pixels: Vec<(Rgb, u32)>,
    mean: [f64; 3],
    /// Sum of squared distances of the colours from their mean, for red, green and blue.
    spread: [f64; 3],
}

impl Set {
    fn of(pixels: Vec<(Rgb, u32)>) -> Self {
        let (mut weight, mut sum, mut squares) = (0.0, [0.0; 3], [0.0; 3]);
        for (rgb, count) in &pixels {
            let count = f64::from(*count);
            weight += count;
            for axis in 0..3 {
                let value = f64::from(rgb[axis]);
                sum[axis] += count * value;
                squares[axis] += count * value * value;
            }
        }
        let mean = sum.map(|sum| sum / f64::max(weight, 1.0));
        Self { pixels, mean, spread: [0, 1, 2].map(|axis| squares[axis] - sum[axis] * mean[axis]) }
    }

    fn colour(&self) -> Rgb {
        self.mean.map(|mean| mean.round() as u8)
    }

    /// Returns the axis along which the colours differ most: 0 for red, 1 for green, 2 for blue.
    fn axis(&self) -> usize {
        let [red, green, blue] = self.spread;
        if red >= green && red >= blue {
            0
        } else if green >= blue {
            1
        } else {
            2
        }
    }

    /// Splits the set at its mean along its axis.
    fn cut(self) -> [Self; 2] {
        let (axis, mean) = (self.axis(), self.mean);
        let low = |(rgb, _): &(Rgb, u32)| f64::from(rgb[axis]) <= mean[axis];
        // sets that are cut have two colours or more, so neither half is empty
        let (low, high) = self.pixels.into_iter().partition(low);
        [Self::of(low), Self::of(high)]
    }
}

/// Returns the index of the set of colours to cut next, or `None` if every set has one colour.
fn widest(sets: &[Set]) -> Option<usize> {
    let several = (0..sets.len()).filter(|&set| sets[set].pixels.len() > 1);
    let spread = |set: &usize| sets[*set].spread.iter().sum::<f64>();
    several.max_by(|a, b| spread(a).total_cmp(&spread(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_stay_as_they_are() {
        let pictures: [&[u8]; 2] = [&[0, 0, 255, 255, 255, 255], &[1, 0, 255, 10, 20, 30]];
        let palette = Palette::from_pictures(pictures);
        assert_eq!(palette.colours.len(), 4);
        for picture in pictures {
            let shown = palette.indices(picture).into_iter();
            let shown: Vec<u8> = shown.flat_map(|i| palette.colours[usize::from(i)]).collect();
            assert_eq!(shown, picture);
        }
    }

    #[test]
    fn many_colours_become_near_ones_and_a_rare_mark_keeps_its_own() {
        let greys = (0..=255).flat_map(|grey: u8| (0..8).map(move |blue| [grey, grey, blue]));
        let mut picture: Vec<u8> = greys.flatten().collect();
        picture.extend([0, 0, 255]);
        let palette = Palette::from_pictures([&picture[..]]);
        assert_eq!(palette.colours.len(), Palette::MAX_COLOURS);
        let indices = palette.indices(&picture);
        for (rgb, index) in picture.chunks_exact(3).zip(&indices) {
            let shown = palette.colours[usize::from(*index)];
            let off = shown.iter().zip(rgb).map(|(a, b)| a.abs_diff(*b));
            assert!(off.max() <= Some(8), "{rgb:?} became {shown:?}");
        }
        let mark = indices.last().map(|&index| palette.colours[usize::from(index)]);
        assert_eq!(mark, Some([0, 0, 255]));
    }
}

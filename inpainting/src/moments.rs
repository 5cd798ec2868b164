//! Image moments: shape of a spot of weighted pixels.

use std::f64::consts::PI;

/// Number of directions, over half a turn, in which the skewness of a spot is evaluated.
const DIRECTIONS: usize = 36;

/// Weighted middle of a spot of pixels, and its central moments of second and third order.
pub(crate) struct ImageMoments {
    middle: [f64; 2],
    /// Central moments of second order: means of column squared, column times row, row squared.
    second: [f64; 3],
    /// Central moments of third order: means of column cubed, column squared times row, column
    /// times row squared, row cubed.
    third: [f64; 4],
}

impl ImageMoments {
    /// Computes the image moments of pixels with weights, which must not add up to zero.
    pub fn of_weighted_pixels(weighed: &[(f64, [f64; 2])]) -> Self {
        let [_, x, y] = sums(weighed, |[x, y]| [1.0, x, y]);
        let all: f64 = weighed.iter().map(|(weight, _)| weight).sum();
        let middle = [x / all, y / all];
        let off = |[px, py]: [f64; 2]| [px - middle[0], py - middle[1]];
        let second = sums(weighed, |place| {
            let [u, v] = off(place);
            [u * u, u * v, v * v]
        });
        let third = sums(weighed, |place| {
            let [u, v] = off(place);
            [u * u * u, u * u * v, u * v * v, v * v * v]
        });
        Self { middle, second: second.map(|sum| sum / all), third: third.map(|sum| sum / all) }
    }

    /// Returns the column and row of the weighted middle of the spot.
    pub fn centroid(&self) -> [f64; 2] {
        self.middle
    }

    /// Returns the ratio of length to width of the ellipse with the spot's second moments; infinite
    /// for a line.
    pub fn elongation(&self) -> f64 {
        let [across, mixed, down] = self.second;
        let half = (across + down) / 2.0;
        let apart = ((across - down) / 2.0).hypot(mixed);
        // rounding may make the squared width of a line negative
        ((half + apart) / (half - apart).max(0.0)).sqrt()
    }

    /// Returns the largest skewness along any direction: zero for shapes that half a turn leaves
    /// unchanged, such as ellipses.
    pub fn max_skewness(&self) -> f64 {
        let angles = (0..DIRECTIONS).map(|step| PI * step as f64 / DIRECTIONS as f64);
        angles.map(|angle| self.skewness_along(angle)).fold(0.0, f64::max)
    }

    /// Returns the absolute skewness along a direction: the third moment over the second to the
    /// power of 3/2.
    fn skewness_along(&self, angle: f64) -> f64 {
        let (s, c) = angle.sin_cos();
        let [xx, xy, yy] = self.second;
        let [xxx, xxy, xyy, yyy] = self.third;
        let second = xx * c * c + 2.0 * xy * c * s + yy * s * s;
        let third = c * c * (xxx * c + 3.0 * xxy * s) + s * s * (3.0 * xyy * c + yyy * s);
        third.abs() / second.powf(1.5)
    }
}

/// Returns the weighted sum of `parts` over all pixels.
fn sums<const N: usize>(
    weighed: &[(f64, [f64; 2])],
    parts: impl Fn([f64; 2]) -> [f64; N],
) -> [f64; N] {
    let mut sums = [0.0; N];
    for &(weight, place) in weighed {
        for (sum, part) in sums.iter_mut().zip(parts(place)) {
            *sum += weight * part;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An ellipse of these half axes, turned, without what is beyond a line.
    fn ellipse([long, short]: [f64; 2], turn: f64, cut: f64) -> Vec<(f64, [f64; 2])> {
        let (s, c) = turn.sin_cos();
        let pixels = (0..200 * 200).map(|i| [f64::from(i % 200), f64::from(i / 200)]);
        let inside = |[x, y]: &[f64; 2]| {
            let [x, y] = [x - 99.5, y - 99.5];
            let [along, across] = [(c * x + s * y) / long, (c * y - s * x) / short];
            along.hypot(across) < 1.0 && along < cut
        };
        pixels.filter(inside).map(|place| (0.5, place)).collect()
    }

    #[test]
    fn whole_ellipses_are_long_and_not_lopsided() {
        for turn in [0.0, 0.4, 1.3] {
            let moments = ImageMoments::of_weighted_pixels(&ellipse([84.0, 70.0], turn, 1.0));
            let [x, y] = moments.centroid();
            assert!((x - 99.5).hypot(y - 99.5) < 1e-9);
            assert!((moments.elongation() - 1.2).abs() < 0.01);
            assert!(moments.max_skewness() < 1e-9);
        }
    }

    #[test]
    fn an_ellipse_that_is_cut_round_is_lopsided() {
        let moments = ImageMoments::of_weighted_pixels(&ellipse([84.0, 70.0], 0.4, 0.6));
        assert!(moments.elongation() < 1.1, "{}", moments.elongation());
        assert!(moments.max_skewness() > 0.15, "{}", moments.max_skewness());
    }

    #[test]
    fn lines_are_infinitely_long() {
        let line: Vec<_> = (0..30).map(|i| (1.0, [7.5, f64::from(i)])).collect();
        assert_eq!(ImageMoments::of_weighted_pixels(&line).elongation(), f64::INFINITY);
    }
}

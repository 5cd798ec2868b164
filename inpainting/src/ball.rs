//! Subpixel detection of a ball of a known colour in a camera picture.

use crate::error::{InpaintingError, check_picture_size, require_that};
use crate::moments::ImageMoments;

/// Minimum number of pixels of a ball in a picture: smaller spots are noise.
const MIN_PIXELS: usize = 20;
/// Minimum distance of a ball's colour from grey (levels of 255).
const MIN_CHROMA: f64 = 80.0;
/// Minimum distance of a pixel's colour from grey for a pixel of a spot, as a fraction of the
/// ball's.
const MIN_PIXEL_CHROMA: f64 = 0.35;
/// Fractions of a spot's median colour at which a pixel gets the weight 0, and from which on it
/// gets the weight 1, in the middle of the ball. Pixels between them are on the edge and partly
/// show the table.
const EDGE: [f64; 2] = [0.1, 0.7];
/// Cosine of the largest angle between the hues of a pixel and of the ball.
const MIN_HUE_COSINE: f64 = 0.8;
/// Maximum elongation (length over width) of a spot that counts as a disc: a ball 40 degrees off
/// the optical axis shows as an ellipse of that elongation.
const MAX_ELONGATION: f64 = 1.3;
/// Maximum skewness (standardised third moment) of a spot that counts as a disc. A disc of which a
/// straight edge hides a sixteenth exceeds it, which moves its middle by 0.04 of its radius.
const MAX_SKEWNESS: f64 = 0.06;

/// Ball for hand-eye calibration, of one strong colour, which nothing else in the picture has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationBall {
    /// Colour of the ball, RGB.
    pub color: [u8; 3],
}

impl CalibrationBall {
    /// Finds the column and row of the ball's middle in `picture` `[height, width, 3]` (pixels; the
    /// middle of the first pixel is at 0.5).
    ///
    /// It returns the middle of the ball's outline. For a ball of 40 mm at 1.3 m, that is at most
    /// 0.07 pixels farther out than the projected centre of the ball. If a straight edge hides
    /// less than the sixteenth that is rejected, the result is off by at most a twentieth of the
    /// radius.
    ///
    /// # Errors
    /// [`InpaintingError::NoBall`]; [`InpaintingError::SeveralBalls`];
    /// [`InpaintingError::BallPartlyHidden`] if more than a sixteenth of the ball is hidden;
    /// [`InpaintingError::InvalidValue`] for a colour that is nearly grey;
    /// [`InpaintingError::WrongLength`].
    pub fn find_centre(&self, picture: &[u8], width: usize) -> Result<[f64; 2], InpaintingError> {
        let hue = self.hue()?;
        let height = picture.len() / 3 / width.max(1);
        check_picture_size("picture", picture, width * height)?;
        let amounts = hue.amounts(picture);
        let spots = spots(&amounts, MIN_PIXEL_CHROMA * hue.strength, [width, height]);
        match &spots[..] {
            [] => Err(InpaintingError::NoBall { color: self.color, least: MIN_PIXELS }),
            [spot] => outline(&amounts, spot, [width, height]),
            several => Err(InpaintingError::SeveralBalls {
                color: self.color,
                places: several.iter().map(|spot| middle(spot, width)).collect(),
            }),
        }
    }

    /// Rejects a colour that is too close to grey to be found.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.hue().map(drop)
    }

    fn hue(&self) -> Result<Hue, InpaintingError> {
        let chroma = chroma(self.color);
        let strength = length(chroma);
        let value = format!("{:?}", self.color);
        let expected = "a strong colour, far from grey, such as [255, 0, 255]";
        require_that(strength >= MIN_CHROMA, "colour of the ball", &value, expected)?;
        Ok(Hue { direction: chroma.map(|part| part / strength), strength })
    }
}

/// Hue as a direction away from grey in RGB.
struct Hue {
    /// Unit vector in RGB from grey to the hue.
    direction: [f64; 3],
    /// Distance of the ball's colour from grey (levels).
    strength: f64,
}

impl Hue {
    /// Returns the amount of the hue in each pixel, a distance from grey (levels); 0 for pixels of
    /// another hue.
    fn amounts(&self, picture: &[u8]) -> Vec<f64> {
        let amount = |rgb: &[u8]| {
            let chroma = chroma([rgb[0], rgb[1], rgb[2]]);
            let along: f64 = chroma.iter().zip(self.direction).map(|(a, b)| a * b).sum();
            if along >= MIN_HUE_COSINE * length(chroma) { along } else { 0.0 }
        };
        picture.chunks_exact(3).map(amount).collect()
    }
}

/// Returns a colour less its grey part, the mean of its channels.
fn chroma(color: [u8; 3]) -> [f64; 3] {
    let levels = color.map(f64::from);
    let mean = levels.iter().sum::<f64>() / 3.0;
    levels.map(|level| level - mean)
}

fn length(of: [f64; 3]) -> f64 {
    of.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Returns the pixel indices of each connected spot in which every pixel has at least `least` of
/// the hue. Spots of fewer than [`MIN_PIXELS`] are left out.
fn spots(amounts: &[f64], least: f64, [width, height]: [usize; 2]) -> Vec<Vec<usize>> {
    let mut open: Vec<bool> = amounts.iter().map(|amount| *amount >= least).collect();
    let mut found = Vec::new();
    for start in 0..amounts.len() {
        if !open[start] {
            continue;
        }
        open[start] = false;
        let mut spot = vec![start];
        let mut next = 0;
        while let Some(&pixel) = spot.get(next) {
            for neighbour in neighbours(pixel, [width, height]) {
                if std::mem::take(&mut open[neighbour]) {
                    spot.push(neighbour);
                }
            }
            next += 1;
        }
        if spot.len() >= MIN_PIXELS {
            found.push(spot);
        }
    }
    found
}

/// Returns the indices of the up to eight pixels around one, in a picture of the given width and
/// height.
fn neighbours(pixel: usize, [width, height]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (column, row) = (pixel % width, pixel / width);
    let rows = row.saturating_sub(1)..=(row + 1).min(height - 1);
    let around = rows.flat_map(move |near_row| {
        let columns = column.saturating_sub(1)..=(column + 1).min(width - 1);
        columns.map(move |near_column| near_row * width + near_column)
    });
    around.filter(move |&other| other != pixel)
}

/// Returns the column and row of a spot's middle, with equal weights for all its pixels.
fn middle(spot: &[usize], width: usize) -> [f64; 2] {
    let columns: usize = spot.iter().map(|pixel| pixel % width).sum();
    let rows: usize = spot.iter().map(|pixel| pixel / width).sum();
    [columns, rows].map(|sum| sum as f64 / spot.len() as f64 + 0.5)
}

/// Returns the column and row of the weighted middle of a spot with its edge, which must be a
/// complete disc.
fn outline(
    amounts: &[f64],
    spot: &[usize],
    [width, height]: [usize; 2],
) -> Result<[f64; 2], InpaintingError> {
    let mut inner: Vec<f64> = spot.iter().map(|&pixel| amounts[pixel]).collect();
    inner.sort_by(f64::total_cmp);
    // relative to the spot's own colour, since exposure and shading change that of the ball
    let median = inner[inner.len() / 2];
    let [none, full] = EDGE.map(|part| part * median);
    let around = spot.iter().flat_map(|&pixel| neighbours(pixel, [width, height]));
    let mut pixels: Vec<usize> = spot.iter().copied().chain(around).collect();
    pixels.sort_unstable();
    pixels.dedup();
    let weighed = pixels.into_iter().map(|pixel| {
        let weight = ((amounts[pixel] - none) / (full - none)).clamp(0.0, 1.0);
        let place = [(pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5];
        (weight, place)
    });
    let moments = ImageMoments::of_weighted_pixels(&weighed.collect::<Vec<_>>());
    let place = moments.centroid();
    let cut = spot.iter().any(|pixel| {
        let (column, row) = (pixel % width, pixel / width);
        column == 0 || row == 0 || column + 1 == width || row + 1 == height
    });
    let is_disc = moments.elongation() <= MAX_ELONGATION && moments.max_skewness() <= MAX_SKEWNESS;
    if is_disc && !cut { Ok(place) } else { Err(InpaintingError::BallPartlyHidden { place }) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SIZE: [usize; 2] = [96, 72];
    const BALL: CalibrationBall = CalibrationBall { color: [255, 0, 255] };
    const TABLE: [f64; 3] = [123.0, 95.0, 78.0];

    /// A table with balls, shaded towards their edges, as a camera of this exposure sees them. A
    /// pixel is the mean of 64 points.
    fn picture(balls: &[([f64; 2], f64)], exposure: f64) -> Vec<u8> {
        let point = |x: f64, y: f64| {
            let ball = balls.iter().find_map(|([column, row], radius)| {
                let off = (x - column).hypot(y - row) / radius;
                (off < 1.0).then(|| 0.55 + 0.45 * (1.0 - off * off).sqrt())
            });
            ball.map_or(TABLE, |shade| BALL.color.map(|level| f64::from(level) * shade))
        };
        let pixel = |index: usize| {
            let (column, row) = ((index % SIZE[0]) as f64, (index / SIZE[0]) as f64);
            let parts = (0..64).map(|part| {
                let [x, y] = [part % 8, part / 8].map(|part| (f64::from(part) + 0.5) / 8.0);
                point(column + x, row + y)
            });
            let sum = parts.fold([0.0; 3], |sum, rgb| [0, 1, 2].map(|i| sum[i] + rgb[i]));
            sum.map(|level| (exposure * level / 64.0).round() as u8)
        };
        (0..SIZE[0] * SIZE[1]).flat_map(pixel).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn a_ball_is_found_to_a_tenth_of_a_pixel(
            column in 20.0..70.0,
            row in 20.0..50.0,
            radius in 4.0..12.0,
            exposure in 0.8..1.2,
        ) {
            let seen = picture(&[([column, row], radius)], exposure);
            let [x, y] = BALL.find_centre(&seen, SIZE[0]).unwrap();
            let off = (x - column).hypot(y - row);
            prop_assert!(off < 0.1, "{off}");
        }
    }

    #[test]
    fn none_two_and_parts_of_one_are_refused() {
        let find = |balls: &[([f64; 2], f64)]| BALL.find_centre(&picture(balls, 1.0), SIZE[0]);
        let ball = ([40.0, 30.0], 8.0);
        assert!(find(&[ball]).is_ok());
        for nothing in [&[][..], &[([40.0, 30.0], 1.5)]] {
            let message = find(nothing).unwrap_err().to_string();
            assert!(message.contains("no ball") && message.contains("[255, 0, 255]"));
        }
        let message = find(&[ball, ([80.0, 60.0], 5.0)]).unwrap_err().to_string();
        assert!(message.contains("2 things") && message.contains("[[40, 30], [80, 60]]"));
        let edge_message = find(&[([2.0, 30.0], 8.0)]).unwrap_err().to_string();
        assert!(edge_message.contains("no disc"), "{edge_message}");
        // an arm over half of it
        let hidden = behind_an_arm(ball, 30);
        let hidden_message = BALL.find_centre(&hidden, SIZE[0]).unwrap_err().to_string();
        assert!(hidden_message.contains("partly hidden"), "{hidden_message}");
    }

    /// A ball with a grey arm over it, which ends at a row.
    fn behind_an_arm(ball: ([f64; 2], f64), end: usize) -> Vec<u8> {
        let mut seen = picture(&[ball], 1.0);
        seen[..end * 3 * SIZE[0]].fill(160);
        seen
    }

    /// A line at half the radius hides a fifth. Less may be accepted, with a small error.
    #[test]
    fn a_ball_of_which_a_fifth_is_hidden_is_refused() {
        let middle = [40.0, 30.0];
        for radius in [5.0, 8.0, 10.0, 12.0] {
            let top = 30 - radius as usize;
            let a_fifth = 30 - (radius / 2.0) as usize;
            for end in top..42 {
                match BALL.find_centre(&behind_an_arm((middle, radius), end), SIZE[0]) {
                    Err(_) => assert_ne!(end, top, "{radius}: nothing is hidden"),
                    Ok([x, y]) => {
                        let off = (x - middle[0]).hypot(y - middle[1]);
                        assert!(off < 0.05 * radius, "{radius}, {end}: {off}");
                        assert!(end < a_fifth, "{radius}, {end}");
                    }
                }
            }
        }
    }

    /// Rounding makes the squared width of some lines negative.
    #[test]
    fn a_line_is_no_disc() {
        for (length, slope) in (22..=60).flat_map(|length| [(length, 0), (length, 1)]) {
            let mut seen = picture(&[], 1.0);
            for row in 0..length {
                let level = (255.0 - 155.0 * row as f64 / length as f64) as u8;
                let pixel = 3 * ((row + 5) * SIZE[0] + slope * row + 7);
                seen[pixel..pixel + 3].copy_from_slice(&[level, 0, level]);
            }
            let found = BALL.find_centre(&seen, SIZE[0]);
            let refused = matches!(found, Err(InpaintingError::BallPartlyHidden { .. }));
            assert!(refused, "{length}, {slope}: {found:?}");
        }
    }

    /// Balls of other hues are no balls, and the darkest and brightest pictures hold none.
    #[test]
    fn other_colours_greys_and_pictures_of_no_size_are_refused() {
        let seen = picture(&[([40.0, 30.0], 8.0)], 1.0);
        for color in [[255, 0, 0], [0, 0, 255], [0, 255, 0], [255, 255, 0]] {
            assert!(CalibrationBall { color }.find_centre(&seen, SIZE[0]).is_err(), "{color:?}");
        }
        let grey = CalibrationBall { color: [120, 110, 100] };
        let message = grey.find_centre(&seen, SIZE[0]).unwrap_err().to_string();
        assert!(message.contains("far from grey"), "{message}");
        for level in [0, 128, 255] {
            let flat = vec![level; seen.len()];
            assert!(matches!(
                BALL.find_centre(&flat, SIZE[0]),
                Err(InpaintingError::NoBall { .. })
            ));
        }
        for width in [0, 5, usize::MAX] {
            assert!(BALL.find_centre(&seen[..7], width).is_err(), "{width}");
        }
        assert!(BALL.find_centre(&[], 0).is_err());
    }
}

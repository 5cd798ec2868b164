//! Film strips of a trial: the camera's pictures, the masks and the policy's pictures.

use envs::RGB_CHANNELS;
use inpainting::{Intrinsics, Perception};

use experiments::colours::curve_rgb;
use experiments::sheet::Picture;
use render::{Film, FilmGridCell, FilmGridRow, FilmLegendEntry, compose_film_grid};

/// Width and height of a picture in a film strip (pixels), in the camera's aspect ratio of 4 to 3.
const CELL: [usize; 2] = [192, 144];
/// Distance between the pictures of a film strip (pixels).
const GAP: usize = 4;
/// Number of decisions from one column of the strip to the next.
const EVERY: usize = 5;

/// Pictures of every decision of a trial: the camera's, the mask and the policy's.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FilmStrip {
    /// Pictures `[144, 192, 3]` of each decision: the camera's, the mask and the policy's.
    columns: Vec<[Vec<u8>; 3]>,
    /// Colour (RGB) of the mark over the gripper in the policy's pictures; `None` without a mark.
    pub(super) mark_colour: Option<[u8; 3]>,
}

impl FilmStrip {
    /// Adds the pictures of a decision to the strip. The policy's picture, `seen`, is square.
    pub(super) fn add_decision(&mut self, raw: &[u8], perception: &Perception, seen: &[u8]) {
        let Intrinsics { width, height, .. } = perception.settings().calibration.intrinsics;
        let view = perception.rectified_camera().intrinsics;
        let mask = perception.arm_mask().iter();
        let mask: Vec<u8> = mask.flat_map(|&hidden| [if hidden { 255 } else { 0 }; 3]).collect();
        let side = (seen.len() / RGB_CHANNELS).isqrt();
        self.columns.push([
            fitted(raw, [width, height]),
            fitted(&mask, [view.width, view.height]),
            fitted(seen, [side, side]),
        ]);
    }

    /// Returns the strip as a picture of three rows: the first decision and every fifth after it.
    pub fn to_picture(&self) -> Picture {
        let [wide, high] = CELL.map(|side| side + GAP);
        let (width, height) = (self.columns.len().div_ceil(EVERY) * wide + GAP, 3 * high + GAP);
        let mut rgb = vec![255; width * height * 3];
        for (column, cells) in self.columns.iter().step_by(EVERY).enumerate() {
            for (row, cell) in cells.iter().enumerate() {
                for (y, line) in cell.chunks_exact(3 * CELL[0]).enumerate() {
                    let start = ((GAP + row * high + y) * width + GAP + column * wide) * 3;
                    rgb[start..][..line.len()].copy_from_slice(line);
                }
            }
        }
        Picture { width, height, rgb }
    }

    /// Returns a film of all decisions with the three pictures side by side.
    pub fn to_film(&self, title: &str) -> Film {
        let cell = |row: usize| FilmGridCell {
            width: CELL[0],
            height: CELL[1],
            frames: self.columns.iter().map(|cells| cells[row].clone()).collect(),
            caption: None,
        };
        let row = FilmGridRow {
            title: title.to_owned(),
            colour: curve_rgb(0),
            cells: [0, 1, 2].map(cell).to_vec(),
        };
        let entry =
            |swatch, text: &str| FilmLegendEntry { swatch: Some(swatch), text: text.into() };
        let mut legend = vec![entry([255; 3], "area that the arm hides, which is filled in")];
        legend.extend(self.mark_colour.map(|colour| entry(colour, "gripper")));
        compose_film_grid(&["camera", "mask", "policy"], &[row], &legend)
    }
}

/// Scales a picture to the largest size that fits into a rectangle of the strip, on white.
fn fitted(picture: &[u8], [width, height]: [usize; 2]) -> Vec<u8> {
    let scale = (CELL[0] as f64 / width as f64).min(CELL[1] as f64 / height as f64);
    let shown = [width, height].map(|side| (side as f64 * scale).round() as usize);
    let left = (CELL[0] - shown[0]) / 2;
    let mut cell = vec![255; CELL[0] * CELL[1] * 3];
    for y in 0..shown[1] {
        for x in 0..shown[0] {
            let [column, row] = [(x, 0), (y, 1)].map(|(at, axis)| {
                let side = [width, height][axis];
                (((at as f64 + 0.5) / scale) as usize).min(side - 1)
            });
            let from = &picture[(row * width + column) * 3..][..3];
            cell[(y * CELL[0] + left + x) * 3..][..3].copy_from_slice(from);
        }
    }
    cell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_fills_a_cell_as_far_as_its_shape_allows() {
        let square = fitted(&[10; 48 * 48 * 3], [48, 48]);
        let dark = |cell: &[u8]| cell.chunks_exact(3).filter(|rgb| rgb[0] == 10).count();
        assert_eq!(dark(&square), 144 * 144);
        assert!(square[..3] == [255; 3] && square[24 * 3..][..3] == [10; 3]);
        assert_eq!(dark(&fitted(&[10; 640 * 480 * 3], [640, 480])), 192 * 144);
        let columns = vec![[square.clone(), square.clone(), square]; 6];
        let strip = FilmStrip { columns, mark_colour: Some([0, 0, 255]) };
        let picture = strip.to_picture();
        assert_eq!((picture.width, picture.height), (2 * 196 + 4, 3 * 148 + 4));
        assert_eq!(dark(&picture.rgb), 6 * 144 * 144);
        let film = strip.to_film("");
        assert_eq!(film.frames.len(), 6);
        let marks = film.frames[0].chunks_exact(3).filter(|pixel| **pixel == [0, 0, 255]);
        assert!(marks.count() > 20, "the legend");
        assert!(film.frames.iter().all(|frame| dark(frame) == 3 * 144 * 144));
    }
}

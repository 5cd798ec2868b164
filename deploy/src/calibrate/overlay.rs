//! Pictures with the mask and the arm in colours.

use inpainting::Perception;

use experiments::sheet::Picture;

/// Factor by which camera pictures are enlarged before mask and arm are drawn.
const ENLARGE: usize = 4;
/// Colours of pixels with mask and arm, with the arm alone, and with the mask alone (RGB).
const COLOURS: [[u8; 3]; 3] = [[0, 200, 0], [255, 0, 0], [40, 90, 255]];
/// Opacity of the colours laid over a picture for mask and arm, out of 256.
const LAID: u32 = 110;

/// Returns the last rectified picture of `perception`, enlarged four times and coloured by its mask
/// and by `arm`, the pixels that show the arm.
pub(super) fn mask_overlay(perception: &Perception, arm: &[bool]) -> Picture {
    let inside = perception.rectified_camera().intrinsics;
    let [width, height] = [inside.width, inside.height].map(|side| side * ENLARGE);
    let pixels = perception.rectified_frame().chunks_exact(3);
    let coloured: Vec<[u8; 3]> = pixels
        .zip(perception.arm_mask().iter().zip(arm))
        .map(|(rgb, (&mask, &arm))| coloured([rgb[0], rgb[1], rgb[2]], mask, arm))
        .collect();
    let enlarged = (0..width * height).map(|index| {
        let (row, column) = (index / width / ENLARGE, index % width / ENLARGE);
        coloured[row * inside.width + column]
    });
    Picture { width, height, rgb: enlarged.flatten().collect() }
}

fn coloured(rgb: [u8; 3], mask: bool, arm: bool) -> [u8; 3] {
    let colour = match (mask, arm) {
        (true, true) => COLOURS[0],
        (false, true) => COLOURS[1],
        (true, false) => COLOURS[2],
        (false, false) => return rgb,
    };
    [0, 1, 2].map(|channel| {
        let (under, over) = (u32::from(rgb[channel]), u32::from(colour[channel]));
        ((under * (256 - LAID) + over * LAID) / 256) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_red_or_blue() {
        let grey = [100; 3];
        assert_eq!(coloured(grey, false, false), grey);
        let [red, _, blue] = coloured(grey, false, true);
        assert!(red > 150 && blue < 60);
        let [other_red, _, other_blue] = coloured(grey, true, false);
        assert!(other_red < 80 && other_blue > 150);
        let [both_red, green, _] = coloured(grey, true, true);
        assert!(both_red < 60 && green > 130);
    }
}

//! Plausibility checks: of a calibration from a file against the rig's own estimate, and of a
//! camera's first picture against the table of the training.

use glam::DQuat;
use inpainting::CameraCalibration;

use crate::DeployError;

/// Maximum distance (metres) and angle (degrees) between the camera of a file and the rig's
/// estimate: 1.5 times the error that a rig's estimate may have (docs/deployment.md, "Drive a
/// real arm").
const LARGEST: [f64; 2] = [0.15, 15.0];
/// Maximum difference between the focal lengths of a file and the rig's, relative to the rig's.
const FOCAL: f64 = 0.1;
/// Maximum distance between the optical axes of a file's and the rig's camera, and between pixels
/// that show one direction, relative to the picture's width.
const SHIFT: f64 = 0.1;
/// Number of points along each side of the picture at which lenses are compared.
const POINTS: usize = 9;

/// Rejects a calibration that cannot be that of the rig's camera, whose own estimate is `known`.
///
/// # Errors
/// [`DeployError::ImplausibleCalibration`].
pub(super) fn check_plausibility(
    file: &CameraCalibration,
    known: &CameraCalibration,
) -> Result<(), DeployError> {
    let (inside, expected) = (&file.intrinsics, &known.intrinsics);
    let size = [inside.width, inside.height];
    let known_size = [expected.width, expected.height];
    require(size == known_size, "size", format!("{size:?} pixels"), || {
        format!("{known_size:?}, the size of the rig's pictures")
    })?;
    for (of, focal) in inside.focal_lengths.iter().zip(expected.focal_lengths) {
        let [low, high] = [1.0 - FOCAL, 1.0 + FOCAL].map(|part| part * focal);
        let value = format!("{of} pixels");
        require((low..=high).contains(of), "focal length", value, || {
            format!("{low:.0} to {high:.0} pixels, the rig's being {focal:.0}")
        })?;
    }
    let most = SHIFT * expected.width as f64;
    let [x, y] = [0, 1].map(|axis| inside.principal_point[axis] - expected.principal_point[axis]);
    let value = format!("at {:?} pixels", inside.principal_point);
    require(x.hypot(y) <= most, "optical axis", value, || {
        format!("at most {most:.0} pixels from {:?}, the rig's", expected.principal_point)
    })?;
    let describe = |shift| match shift {
        Shift::Pixels(pixels) => format!("bent by up to {pixels:.0} pixels against the rig's"),
        Shift::Hidden(pixel) => {
            format!("one that shows nothing at pixel {pixel:?}, where the rig's does")
        }
    };
    let shift = shift(file, known);
    let holds = matches!(shift, Shift::Pixels(pixels) if pixels <= most);
    require(holds, "lens", describe(shift), || {
        format!("at most {most:.0} pixels from where the rig's shows a point")
    })?;
    let [place, angle] = distance_m_and_angle_deg(file, known);
    let position = format!("{:.3} m", file.camera_position());
    require(place <= LARGEST[0], "position", position, || {
        format!("at most {} m from {:.3} m, the rig's", LARGEST[0], known.camera_position())
    })?;
    let rotation = format!("turned by {angle:.0} degrees against the rig's");
    require(angle <= LARGEST[1], "rotation", rotation, || format!("at most {} degrees", LARGEST[1]))
}

/// Returns the distance between two cameras (metres) and the angle between them (degrees).
pub(super) fn distance_m_and_angle_deg(
    one: &CameraCalibration,
    other: &CameraCalibration,
) -> [f64; 2] {
    let turn = one.extrinsics.rotation * other.extrinsics.rotation.transpose();
    let angle = DQuat::from_mat3(&turn).to_scaled_axis().length();
    // a quaternion and its negative are the same rotation, so the angle may exceed half a turn
    let angle = angle.min(std::f64::consts::TAU - angle);
    [one.camera_position().distance(other.camera_position()), angle.to_degrees()]
}

/// Largest difference (levels) of a channel, in corrected colours, of a pixel that shows the table.
const SAME_LEVELS: u8 = 24;
/// Minimum share of the first picture that shows the table.
const MIN_TABLE_SHARE: f64 = 0.5;
/// Minimum brightness of the first picture, relative to the training's.
const MIN_BRIGHTNESS: f64 = 0.25;
/// Maximum ratio of the brightness of two channels: that of white and grey tables is 1.6.
const MAX_TINT: f64 = 2.0;

/// Rejects a first picture that does not show the `table` `[H, W, 3]` of the training: `rectified`
/// `[h, w, 3]` in the camera's colours, `corrected` `[H, W, 3]` in those of the training.
///
/// # Errors
/// [`DeployError::UnknownTable`].
pub(super) fn check_table(
    rectified: &[u8],
    corrected: &[u8],
    table: &[u8],
) -> Result<(), DeployError> {
    let light = [0, 1, 2].map(|channel| median(rectified, channel) / median(table, channel));
    let [least, most] =
        light.iter().fold([f64::INFINITY, 0.0], |[low, high], &of| [of.min(low), of.max(high)]);
    let is_same = |(a, b): &(&[u8], &[u8])| {
        a.iter().zip(*b).all(|(level, known)| level.abs_diff(*known) <= SAME_LEVELS)
    };
    let pixels = corrected.chunks_exact(3).zip(table.chunks_exact(3));
    let share = pixels.filter(is_same).count() as f64 / (table.len() / 3) as f64;
    for (holds, part, value, expected) in [
        (most >= MIN_BRIGHTNESS, "brightness", most, "0.25 or more"),
        (most <= MAX_TINT * least, "tint", most / least, "2 or less"),
        (share >= MIN_TABLE_SHARE, "share of table", share, "0.5 or more"),
    ] {
        if !holds {
            return Err(DeployError::UnknownTable { part, value, expected });
        }
    }
    Ok(())
}

/// Returns the median level of a channel of an RGB picture, at least 1.
fn median(rgb: &[u8], channel: usize) -> f64 {
    let mut levels: Vec<u8> = rgb.chunks_exact(3).map(|pixel| pixel[channel]).collect();
    let middle = levels.len() / 2;
    f64::from(*levels.select_nth_unstable(middle).1).max(1.0)
}

/// Difference between the distortions of two lenses.
enum Shift {
    /// Largest distance between the pixels at which they show the same direction.
    Pixels(f64),
    /// Pixel at which the known lens shows a direction that the other one does not show.
    Hidden([f64; 2]),
}

/// Compares the distortions of two lenses on a grid of pixels, with the rig's focal lengths for
/// both.
fn shift(file: &CameraCalibration, known: &CameraCalibration) -> Shift {
    // only the lens differs, so that errors of the pose do not count twice
    let bent = CameraCalibration { distortion: file.distortion, ..*known };
    let size = [known.intrinsics.width, known.intrinsics.height];
    let mut largest: f64 = 0.0;
    for index in 0..POINTS * POINTS {
        let parts = [index % POINTS, index / POINTS].map(|i| i as f64 / (POINTS - 1) as f64);
        let pixel = [0, 1].map(|axis| parts[axis] * size[axis] as f64);
        // a lens may leave the corners of its picture dark
        let Some(way) = known.world_direction_of_pixel(pixel) else {
            continue;
        };
        let Some([column, row]) = bent.project_world_direction(way) else {
            return Shift::Hidden(pixel);
        };
        largest = largest.max((column - pixel[0]).hypot(row - pixel[1]));
    }
    Shift::Pixels(largest)
}

fn require(
    holds: bool,
    part: &'static str,
    value: String,
    expected: impl Fn() -> String,
) -> Result<(), DeployError> {
    if holds {
        return Ok(());
    }
    let expected = expected();
    Err(DeployError::ImplausibleCalibration { part, value, expected })
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};
    use inpainting::{Extrinsics, Intrinsics, LensDistortion};

    use super::*;

    fn known() -> CameraCalibration {
        CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::NONE,
            extrinsics: Extrinsics::overhead(1.5),
        }
    }

    fn hung(rotation: DMat3, position: DVec3) -> CameraCalibration {
        let rotation = rotation * Extrinsics::overhead(0.0).rotation;
        CameraCalibration {
            extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
            ..known()
        }
    }

    fn inside(spoil: fn(&mut Intrinsics)) -> CameraCalibration {
        let mut calibration = known();
        spoil(&mut calibration.intrinsics);
        calibration
    }

    fn bent(radial: [f64; 2]) -> CameraCalibration {
        CameraCalibration {
            distortion: LensDistortion::brown_conrady(radial, [0.001; 2]),
            ..known()
        }
    }

    /// Checks that a correct file is accepted by rigs with the largest allowed error.
    #[test]
    fn cameras_within_10_cm_and_10_degrees_are_plausible() {
        let diagonal = DVec3::ONE.normalize();
        for axis in [DVec3::X, -DVec3::Y, DVec3::Z, diagonal] {
            let turn = DMat3::from_axis_angle(axis, 10_f64.to_radians());
            check_plausibility(&hung(turn, 1.5 * DVec3::Z + 0.1 * diagonal), &known()).unwrap();
            check_plausibility(&known(), &hung(turn, 1.5 * DVec3::Z - 0.1 * diagonal)).unwrap();
        }
        check_plausibility(&bent([0.05, -0.05]), &known()).unwrap();
        check_plausibility(&inside(|of| of.focal_lengths = [600.0, 630.0]), &known()).unwrap();
        check_plausibility(&inside(|of| of.principal_point = [300.0, 255.0]), &known()).unwrap();
    }

    /// Checks lenses whose pictures have dark corners.
    #[test]
    fn lenses_that_show_nothing_in_corners_are_compared_elsewhere() {
        for radial in [[-0.37, 0.0], [-0.4, 0.0], [-0.49, -0.49]] {
            let lens = bent(radial);
            check_plausibility(&lens, &lens).unwrap();
            assert!(lens.world_direction_of_pixel([640.0, 480.0]).is_none());
        }
        check_plausibility(&bent([-0.35, 0.0]), &bent([-0.35, 0.0])).unwrap();
        let message = check_plausibility(&known(), &bent([-0.4, 0.0])).unwrap_err().to_string();
        assert!(message.contains("bent by up to"), "{message}");
    }

    #[test]
    fn tables_in_other_light_are_known_and_other_surfaces_are_not() {
        const SIZE: usize = 24;
        let of = |colour: [u8; 3]| colour.repeat(SIZE * SIZE);
        let table = of([123, 95, 79]);
        for seen in [[123, 95, 79], [40, 30, 27], [100; 3], [230; 3]] {
            check_table(&of(seen), &table, &table).unwrap();
        }
        let half = SIZE * SIZE / 2;
        let stripes = [[123, 95, 79].repeat(half - 1), [160, 95, 79].repeat(half + 1)].concat();
        for (seen, corrected, says) in [
            (of([3; 3]), &table, "its brightness is 0.038, expected 0.25 or more"),
            (of([40, 60, 150]), &table, "its tint is 5.839, expected 2 or less"),
            (table.clone(), &stripes, "its share of table is 0.498, expected 0.5 or more"),
        ] {
            let message = check_table(&seen, corrected, &table).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    #[test]
    fn other_cameras_are_refused_with_what_was_expected() {
        let at = |x: f64, z: f64| hung(DMat3::IDENTITY, DVec3::new(x, 0.0, z));
        let turned = |axis: DVec3, degrees: f64| {
            let turn = DMat3::from_axis_angle(axis, degrees.to_radians());
            hung(turn, 1.5 * DVec3::Z)
        };
        for (file, says) in [
            (turned(DVec3::Z, 180.0), ["rotation", "180 degrees", "15 degrees"]),
            (turned(DVec3::Z, 90.0), ["rotation", "90 degrees", "15 degrees"]),
            (turned(DVec3::X, 180.0), ["rotation", "180 degrees", "15 degrees"]),
            (turned(DVec3::X, 90.0), ["rotation", "90 degrees", "15 degrees"]),
            (inside(|of| of.focal_lengths = [1.93; 2]), ["focal length", "1.93", "554 to 676"]),
            (
                inside(|of| of.principal_point = [240.0, 318.0]),
                ["optical axis", "[240.0, 318.0]", "[318.0, 240.0]"],
            ),
            (inside(|of| (of.width, of.height) = (480, 640)), ["size", "[480, 640]", "[640, 480]"]),
            (at(0.0, 99.9), ["position", "99.900", "1.500"]),
            (at(0.0, 3.0), ["position", "3.000", "0.15 m"]),
            (at(0.2, 1.5), ["position", "0.200", "0.15 m"]),
            (bent([0.49, 0.49]), ["lens", "bent by up to", "64 pixels"]),
            (bent([-0.49, -0.49]), ["lens", "shows nothing at pixel [0.0, 0.0]", "64 pixels"]),
        ] {
            let message = check_plausibility(&file, &known()).unwrap_err().to_string();
            let advice = ["`covers calibrate`", "`covers check mask`"];
            for words in says.iter().chain(&advice) {
                assert!(message.contains(words), "{words}: {message}");
            }
        }
    }
}

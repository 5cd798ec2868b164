//! What is known of a real camera: intrinsics, distortion, and where it is.

use glam::DVec3;

use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::distortion::Distortion;
use crate::error::InpaintingError;

/// How near (focal lengths) two directions are that are the same but for rounding.
const SAME: f64 = 1e-6;

/// A calibrated camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Size, focal lengths and optical axis.
    pub intrinsics: Intrinsics,
    /// How the lens bends the picture.
    pub distortion: Distortion,
    /// Where the camera is.
    pub extrinsics: Extrinsics,
}

impl Calibration {
    /// Refuses what [`PinholeCamera::check`] refuses, and distortions of more than 0.5.
    ///
    /// # Errors
    /// [`InpaintingError::Value`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.pinhole().check()?;
        self.distortion.check()
    }

    /// The same camera without distortion.
    pub fn pinhole(&self) -> PinholeCamera {
        PinholeCamera { intrinsics: self.intrinsics, extrinsics: self.extrinsics }
    }

    /// Where the camera is in the world (metres).
    pub fn position(&self) -> DVec3 {
        self.extrinsics.position()
    }

    /// Column and row (pixels; the middle of the first one is at one half) in which the world's
    /// direction `way` shows; none behind the camera, and none beyond a fold of the lens' formula,
    /// where it names a place that shows something else.
    pub fn pixel(&self, way: DVec3) -> Option<[f64; 2]> {
        let seen = self.extrinsics.rotation * way;
        let straight = [seen.x / seen.z, seen.y / seen.z];
        let bent = self.distortion.apply(straight);
        let shown = self.distortion.invert(bent)?;
        let off = (shown[0] - straight[0]).hypot(shown[1] - straight[1]);
        let Intrinsics { focal, centre, .. } = self.intrinsics;
        let pixel = [0, 1].map(|axis| focal[axis] * bent[axis] + centre[axis]);
        (seen.z > 0.0 && off < SAME).then_some(pixel)
    }

    /// The world's direction that shows at a column and row; none where the lens shows nothing.
    pub fn direction(&self, pixel: [f64; 2]) -> Option<DVec3> {
        let [x, y] = self.ideal(pixel)?;
        Some(self.extrinsics.rotation.transpose() * DVec3::new(x, y, 1.0))
    }

    /// Gradients of the column and of the row (pixels a metre) by a point in the camera's frame.
    pub(crate) fn slopes(&self, seen: DVec3) -> [DVec3; 2] {
        let straight = [seen.x / seen.z, seen.y / seen.z];
        let (_, bent) = self.distortion.bend(straight);
        let across = DVec3::new(1.0, 0.0, -straight[0]) / seen.z;
        let down = DVec3::new(0.0, 1.0, -straight[1]) / seen.z;
        let focal = self.intrinsics.focal;
        [0, 1].map(|axis| focal[axis] * (bent[axis][0] * across + bent[axis][1] * down))
    }

    /// Where a pinhole of focal length 1 shows what the lens shows at a column and row.
    pub(crate) fn ideal(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let Intrinsics { focal, centre, .. } = self.intrinsics;
        let bent = [0, 1].map(|axis| (pixel[axis] - centre[axis]) / focal[axis]);
        self.distortion.invert(bent)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::DMat3;

    use super::*;

    const BENT: Distortion = Distortion { radial: [0.03, -0.03], tangential: [0.001, -0.001] };

    /// A camera 1.5 m over the table that looks straight down, as far as anybody knows.
    pub fn overhead() -> Calibration {
        Calibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: Distortion::NONE,
            extrinsics: Extrinsics::overhead(1.5),
        }
    }

    #[test]
    fn directions_and_pixels_are_inverse_to_each_other() {
        let camera = Calibration {
            distortion: BENT,
            extrinsics: Extrinsics {
                rotation: DMat3::from_rotation_x(3.0) * DMat3::from_rotation_z(0.4),
                translation: DVec3::new(0.1, -0.2, 1.4),
            },
            ..overhead()
        };
        camera.check().unwrap();
        for pixel in [[0.5, 0.5], [639.5, 479.5], [100.2, 300.7]] {
            let way = camera.direction(pixel).unwrap();
            let [column, row] = camera.pixel(7.0 * way).unwrap();
            let off = (column - pixel[0]).hypot(row - pixel[1]);
            assert!(off < 1e-9, "{off}");
            assert_eq!(camera.pixel(-way), None, "behind");
        }
    }

    #[test]
    fn slopes_are_differences() {
        let camera = Calibration {
            distortion: BENT,
            extrinsics: Extrinsics { rotation: DMat3::IDENTITY, translation: DVec3::ZERO },
            ..overhead()
        };
        let seen = DVec3::new(0.3, -0.2, 1.1);
        for (axis, way) in DVec3::AXES.into_iter().enumerate() {
            let [low, high] = [-1e-6, 1e-6].map(|by| camera.pixel(seen + by * way).unwrap());
            for (part, slope) in camera.slopes(seen).into_iter().enumerate() {
                let difference = (high[part] - low[part]) / 2e-6;
                assert!((slope[axis] - difference).abs() < 1e-4, "{slope}");
            }
        }
    }

    #[test]
    fn without_distortion_it_is_the_pinhole() {
        let camera = overhead();
        let point = DVec3::new(0.2, -0.1, 0.3);
        let [right, down] = camera.pinhole().project(point).unwrap();
        let [column, row] = camera.pixel(point - camera.position()).unwrap();
        let centre = camera.intrinsics.centre;
        assert!((column - centre[0] - right).abs() < 1e-9 && (row - centre[1] - down).abs() < 1e-9);
        assert!(column > centre[0] && row > centre[1], "x is right, -y down");
        assert_eq!(camera.position(), 1.5 * DVec3::Z);
    }

    /// At 0.82 focal lengths from the axis, x (1 - x^2 / 2) is largest, so the formula names the
    /// place of 0.62 for what stands at 1 as well.
    #[test]
    fn nothing_shows_beyond_a_fold() {
        let camera = Calibration {
            distortion: Distortion { radial: [-0.5, 0.0], tangential: [0.0; 2] },
            extrinsics: Extrinsics { rotation: DMat3::IDENTITY, translation: DVec3::ZERO },
            ..overhead()
        };
        let place = |x| camera.pixel(DVec3::new(x, 0.0, 1.0));
        let [column, row] = place(0.6180339887498949).unwrap();
        assert!((column - 318.0 - 0.5 * 615.0).abs() < 1e-6 && row == 240.0);
        assert_eq!(place(1.0), None);
    }

    #[test]
    fn a_lens_that_is_no_lens_is_refused() {
        let camera = Calibration {
            distortion: Distortion { radial: [f64::NAN, 0.0], ..Distortion::NONE },
            ..overhead()
        };
        let message = camera.check().unwrap_err().to_string();
        assert!(message.contains("`distortion`") && message.contains("NaN"), "{message}");
    }
}

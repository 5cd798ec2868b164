//! Calibration of a real camera: intrinsics, distortion and extrinsics.

use glam::DVec3;

use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::distortion::LensDistortion;
use crate::error::{InpaintingError, require_that};

/// Largest displacement of a point by the distortion of a lens, relative to the distance from the
/// optical axis.
const MAX_SHIFT: f64 = 0.5;
/// Number of points between the optical axis and an edge of the picture at which a lens distortion
/// is checked.
const PARTS: usize = 8;
/// Largest distance (focal lengths) of two viewing directions that count as equal, because of
/// rounding.
const TOLERANCE: f64 = 1e-6;

/// Calibration of a camera: intrinsics, lens distortion, and pose in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraCalibration {
    /// Intrinsics of the camera: picture size, focal lengths and principal point.
    pub intrinsics: Intrinsics,
    /// Distortion of the lens.
    pub distortion: LensDistortion,
    /// Pose of the camera in the world.
    pub extrinsics: Extrinsics,
}

impl CameraCalibration {
    /// Rejects an invalid camera ([`PinholeCamera::check`]), and a lens that displaces points
    /// between the optical axis and the edges of the picture by more than half of their distance
    /// from the axis.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.to_pinhole().check()?;
        self.distortion.check()?;
        let Intrinsics { width, height, focal_lengths: focal, principal_point: centre } =
            self.intrinsics;
        let edges = [[0, 0], [0, width], [1, 0], [1, height]].map(|[axis, end]| {
            let mut point = [0.0; 2];
            point[axis] = (end as f64 - centre[axis]) / focal[axis];
            point
        });
        // coefficients alone tell nothing: those of a narrow or a rational lens are large
        // a rational lens may have a pole before the edge
        let mut points = edges.iter().flat_map(|edge| {
            (1..=PARTS).map(|part| edge.map(|coordinate| part as f64 / PARTS as f64 * coordinate))
        });
        let is_slight = points.all(|[x, y]| {
            let [u, v] = self.distortion.distort([x, y]);
            (u - x).hypot(v - y) <= MAX_SHIFT * x.hypot(y)
        });
        let expected = "a lens that displaces no part of the picture by more than half of its \
                        distance from the optical axis";
        require_that(is_slight, "distortion", &self.distortion, expected)
    }

    /// Returns this camera without the distortion of its lens.
    pub fn to_pinhole(&self) -> PinholeCamera {
        PinholeCamera { intrinsics: self.intrinsics, extrinsics: self.extrinsics }
    }

    /// Returns the position of the camera in the world (metres).
    pub fn camera_position(&self) -> DVec3 {
        self.extrinsics.camera_position()
    }

    /// Returns the column and row (pixels; the middle of the first one is at 0.5) that show the
    /// world's direction `direction`.
    ///
    /// `None` behind the camera, and beyond a fold of the distortion, where the formula leads to a
    /// pixel that shows another direction.
    pub fn project_world_direction(&self, direction: DVec3) -> Option<[f64; 2]> {
        let seen = self.extrinsics.rotation * direction;
        let straight = [seen.x / seen.z, seen.y / seen.z];
        let bent = self.distortion.distort(straight);
        // beyond a fold the inverse leads back to another direction
        let shown = self.distortion.undistort(bent)?;
        let off = (shown[0] - straight[0]).hypot(shown[1] - straight[1]);
        let Intrinsics { focal_lengths: focal, principal_point: centre, .. } = self.intrinsics;
        let pixel = [0, 1].map(|axis| focal[axis] * bent[axis] + centre[axis]);
        (seen.z > 0.0 && off < TOLERANCE).then_some(pixel)
    }

    /// Returns the direction in the world, not of unit length, that the pixel at a column and row
    /// shows; `None` if the lens shows nothing there.
    pub fn world_direction_of_pixel(&self, pixel: [f64; 2]) -> Option<DVec3> {
        let [x, y] = self.undistort_pixel(pixel)?;
        Some(self.extrinsics.rotation.transpose() * DVec3::new(x, y, 1.0))
    }

    /// Returns the gradients of the column and of the row (pixels per metre) with respect to a
    /// point in the camera's frame.
    pub(crate) fn pixel_gradients(&self, seen: DVec3) -> [DVec3; 2] {
        let straight = [seen.x / seen.z, seen.y / seen.z];
        let (_, bent) = self.distortion.distort_with_jacobian(straight);
        let across = DVec3::new(1.0, 0.0, -straight[0]) / seen.z;
        let down = DVec3::new(0.0, 1.0, -straight[1]) / seen.z;
        let focal = self.intrinsics.focal_lengths;
        [0, 1].map(|axis| focal[axis] * (bent[axis][0] * across + bent[axis][1] * down))
    }

    /// Returns the point at which a pinhole of focal length 1 shows what the lens shows at a column
    /// and row. `None` if the lens shows nothing there.
    pub(crate) fn undistort_pixel(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let Intrinsics { focal_lengths: focal, principal_point: centre, .. } = self.intrinsics;
        let bent = [0, 1].map(|axis| (pixel[axis] - centre[axis]) / focal[axis]);
        self.distortion.undistort(bent)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::DMat3;

    use super::*;

    const BENT: LensDistortion = LensDistortion::brown_conrady([0.03, -0.03], [0.001, -0.001]);

    /// Returns a calibration 1.5 m over the table that looks straight down.
    pub fn overhead() -> CameraCalibration {
        CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::NONE,
            extrinsics: Extrinsics::overhead(1.5),
        }
    }

    #[test]
    fn directions_and_pixels_are_inverse_to_each_other() {
        let camera = CameraCalibration {
            distortion: BENT,
            extrinsics: Extrinsics {
                rotation: DMat3::from_rotation_x(3.0) * DMat3::from_rotation_z(0.4),
                translation: DVec3::new(0.1, -0.2, 1.4),
            },
            ..overhead()
        };
        camera.check().unwrap();
        for pixel in [[0.5, 0.5], [639.5, 479.5], [100.2, 300.7]] {
            let way = camera.world_direction_of_pixel(pixel).unwrap();
            let [column, row] = camera.project_world_direction(7.0 * way).unwrap();
            let off = (column - pixel[0]).hypot(row - pixel[1]);
            assert!(off < 1e-9, "{off}");
            assert_eq!(camera.project_world_direction(-way), None, "behind");
        }
    }

    #[test]
    fn slopes_are_differences() {
        let camera = CameraCalibration {
            distortion: BENT,
            extrinsics: Extrinsics { rotation: DMat3::IDENTITY, translation: DVec3::ZERO },
            ..overhead()
        };
        let seen = DVec3::new(0.3, -0.2, 1.1);
        for (axis, way) in DVec3::AXES.into_iter().enumerate() {
            let [low, high] =
                [-1e-6, 1e-6].map(|by| camera.project_world_direction(seen + by * way).unwrap());
            for (part, slope) in camera.pixel_gradients(seen).into_iter().enumerate() {
                let difference = (high[part] - low[part]) / 2e-6;
                assert!((slope[axis] - difference).abs() < 1e-4, "{slope}");
            }
        }
    }

    #[test]
    fn without_distortion_it_is_the_pinhole() {
        let camera = overhead();
        let point = DVec3::new(0.2, -0.1, 0.3);
        let [right, down] = camera.to_pinhole().project(point).unwrap();
        let [column, row] =
            camera.project_world_direction(point - camera.camera_position()).unwrap();
        let centre = camera.intrinsics.principal_point;
        assert!((column - centre[0] - right).abs() < 1e-9 && (row - centre[1] - down).abs() < 1e-9);
        assert!(column > centre[0] && row > centre[1], "x is right, -y down");
        assert_eq!(camera.camera_position(), 1.5 * DVec3::Z);
    }

    /// At 0.82 focal lengths from the axis, x (1 - x^2 / 2) is largest, so the formula names the
    /// place of 0.62 for what stands at 1 as well.
    #[test]
    fn nothing_shows_beyond_a_fold() {
        let camera = CameraCalibration {
            distortion: LensDistortion::brown_conrady([-0.5, 0.0], [0.0; 2]),
            extrinsics: Extrinsics { rotation: DMat3::IDENTITY, translation: DVec3::ZERO },
            ..overhead()
        };
        let place = |x| camera.project_world_direction(DVec3::new(x, 0.0, 1.0));
        let [column, row] = place(0.6180339887498949).unwrap();
        assert!((column - 318.0 - 0.5 * 615.0).abs() < 1e-6 && row == 240.0);
        assert_eq!(place(1.0), None);
    }

    #[test]
    fn a_lens_that_is_no_lens_is_refused() {
        let check = |radial: [f64; 6]| {
            let distortion = LensDistortion { radial, ..LensDistortion::NONE };
            CameraCalibration { distortion, ..overhead() }.check()
        };
        for (k1, says) in [(f64::NAN, "NaN"), (3.0, "3.0"), (-3.0, "-3.0")] {
            let message = check([k1, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap_err().to_string();
            assert!(message.contains("`distortion`") && message.contains(says), "{message}");
        }
        // (1 - 17 r^2)^2 / (1 - 20 r^2)^2 is moderate at the edges, and has a pole before them
        let pole = check([-34.0, 289.0, 0.0, -40.0, 400.0, 0.0]).unwrap_err().to_string();
        assert!(pole.contains("289.0"), "{pole}");
        // a wide lens, a rational one, and a narrow one with a large k3
        check([-0.35, 0.15, -0.03, 0.0, 0.0, 0.0]).unwrap();
        check([8.0, -20.0, 3.0, 8.1, -19.0, 1.0]).unwrap();
        check([-0.2, 1.5, -6.0, 0.0, 0.0, 0.0]).unwrap();
    }
}

//! Pinhole camera: intrinsics, extrinsics, projection and viewing rays.

use glam::{DMat3, DVec3};

use crate::error::{InpaintingError, require_that};

/// Largest accepted coordinate of a point (metres). Squares of far larger ones overflow.
const MAX_COORDINATE: f64 = 1e9;

/// Intrinsic parameters of a pinhole camera.
///
/// Pixel (column, row) covers `[column, column + 1) x [row, row + 1)`; row 0 is the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Width of the picture (pixels).
    pub width: usize,
    /// Height of the picture (pixels).
    pub height: usize,
    /// Horizontal and vertical focal lengths (pixels).
    pub focal_lengths: [f64; 2],
    /// Principal point: column and row of the optical axis (pixels).
    pub principal_point: [f64; 2],
}

impl Intrinsics {
    /// Intrinsics of the colour camera of an Intel RealSense D435 at 640 x 480: about the mean of
    /// what owners report (focal lengths of 607 to 618 pixels, an axis within a few pixels of the
    /// middle).
    pub const REALSENSE_D435: Self = Self {
        width: 640,
        height: 480,
        focal_lengths: [615.0; 2],
        principal_point: [318.0, 240.0],
    };

    fn check(&self) -> Result<(), InpaintingError> {
        let size = format!("{} x {}", self.width, self.height);
        let bytes = self.width.checked_mul(self.height);
        let bytes = bytes.and_then(|pixels| pixels.checked_mul(3));
        let holds = bytes.is_some_and(|bytes| bytes > 0 && bytes <= isize::MAX as usize);
        let expected = "at least 1 x 1, and a picture that fits into memory";
        require_that(holds, "picture size", &size, expected)?;
        let positive = self.focal_lengths.iter().all(|f| *f > 0.0 && f.is_finite());
        let (value, expected_focal) =
            (format!("{:?}", self.focal_lengths), "two positive numbers of pixels");
        require_that(positive, "focal length", &value, expected_focal)?;
        let finite = self.principal_point.iter().all(|c| c.is_finite());
        let centre = format!("{:?}", self.principal_point);
        require_that(finite, "optical axis", &centre, "two finite numbers")
    }
}

/// Pose of a camera: `rotation * world + translation` is a point in the camera's frame, x right, y
/// down, z forward (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extrinsics {
    /// Rotation from the world's axes to the camera's.
    pub rotation: DMat3,
    /// Position of the world's origin in the camera's frame (metres).
    pub translation: DVec3,
}

impl Extrinsics {
    /// Returns the pose of a camera `height` (metres) over the world's origin that looks straight
    /// down; right in the picture is x, and up is y.
    pub fn overhead(height: f64) -> Self {
        Self {
            rotation: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            translation: height * DVec3::Z,
        }
    }

    /// Returns the position of the camera in the world (metres).
    pub fn camera_position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    fn check(&self) -> Result<(), InpaintingError> {
        let Self { rotation, translation } = self;
        let orthonormal = (rotation * rotation.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-6);
        let holds = orthonormal && rotation.determinant() > 0.0;
        require_that(
            holds,
            "rotation",
            rotation,
            "an orthonormal matrix of determinant 1, to six decimals",
        )?;
        require_valid_coordinates("translation", *translation)
    }
}

/// Condition of [`has_valid_coordinates`] in words, for error messages.
pub(crate) const VALID_COORDINATES: &str = "three numbers of metres, each at most 1e9";

/// Returns `true` if a point is finite and no coordinate exceeds [`MAX_COORDINATE`].
pub(crate) fn has_valid_coordinates(point: DVec3) -> bool {
    point.abs().cmple(DVec3::splat(MAX_COORDINATE)).all()
}

pub(crate) fn require_valid_coordinates(
    name: &'static str,
    point: DVec3,
) -> Result<(), InpaintingError> {
    require_that(has_valid_coordinates(point), name, &point, VALID_COORDINATES)
}

/// Calibrated camera without distortion, with the projection matrix `K [R | t]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeCamera {
    /// Intrinsics `K`: picture size, focal lengths and principal point.
    pub intrinsics: Intrinsics,
    /// Extrinsics `[R | t]`: pose of the camera in the world.
    pub extrinsics: Extrinsics,
}

impl PinholeCamera {
    /// Returns a camera `height` (metres) over the world's origin that looks straight down. Its
    /// pictures of `size` x `size` pixels show the table up to `half_extent` (metres) to all sides.
    pub fn overhead(size: usize, height: f64, half_extent: f64) -> Self {
        let middle = size as f64 / 2.0;
        Self {
            intrinsics: Intrinsics {
                width: size,
                height: size,
                focal_lengths: [middle * height / half_extent; 2],
                principal_point: [middle; 2],
            },
            extrinsics: Extrinsics::overhead(height),
        }
    }

    /// Rejects empty and excessively large pictures, focal lengths that are not positive, and
    /// matrices that are no rotation.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.intrinsics.check()?;
        self.extrinsics.check()
    }

    /// Projects a point of the world to its offset from the principal point, columns to the right
    /// and rows down (pixels); `None` behind the camera.
    pub fn project(&self, point: DVec3) -> Option<[f64; 2]> {
        let seen = self.world_to_camera(point);
        let [fx, fy] = self.intrinsics.focal_lengths;
        (seen.z > 0.0).then(|| [fx * seen.x / seen.z, fy * seen.y / seen.z])
    }

    /// Transforms a point of the world into the camera's frame (metres).
    pub(crate) fn world_to_camera(&self, point: DVec3) -> DVec3 {
        self.extrinsics.rotation * point + self.extrinsics.translation
    }

    /// Returns the unit vector through the middle of a pixel, in the camera's frame.
    pub(crate) fn pixel_ray(&self, row: usize, column: usize) -> DVec3 {
        let Intrinsics { focal_lengths: focal, principal_point: centre, .. } = self.intrinsics;
        let x = (column as f64 + 0.5 - centre[0]) / focal[0];
        let y = (row as f64 + 0.5 - centre[1]) / focal[1];
        DVec3::new(x, y, 1.0).normalize()
    }

    /// Returns the number of pixels of the camera's pictures.
    pub fn num_pixels(&self) -> usize {
        self.intrinsics.width * self.intrinsics.height
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a tilted camera whose pictures are not square.
    pub fn askew() -> PinholeCamera {
        let rotation = DMat3::from_rotation_x(2.4) * DMat3::from_rotation_z(0.3);
        PinholeCamera {
            intrinsics: Intrinsics {
                width: 40,
                height: 30,
                focal_lengths: [35.0, 33.0],
                principal_point: [21.0, 14.5],
            },
            extrinsics: Extrinsics { rotation, translation: DVec3::new(0.1, -0.05, 1.2) },
        }
    }

    /// Projecting a point on the ray of a pixel returns the pixel.
    #[test]
    fn projections_are_where_rays_come_from() {
        let camera = askew();
        let Extrinsics { rotation, translation } = camera.extrinsics;
        let [cx, cy] = camera.intrinsics.principal_point;
        for (index, depth) in (0..camera.num_pixels()).zip([0.01, 0.7, 30.0].into_iter().cycle()) {
            let (row, column) = (index / 40, index % 40);
            let point =
                rotation.transpose() * (depth * camera.pixel_ray(row, column) - translation);
            let [right, down] = camera.project(point).unwrap();
            let off =
                (right + cx - (column as f64 + 0.5)).abs() + (down + cy - (row as f64 + 0.5)).abs();
            assert!(off < 1e-12 * (1.0 + 1.0 / depth), "{index}: {off} pixels");
            let behind =
                rotation.transpose() * (-depth * camera.pixel_ray(row, column) - translation);
            assert_eq!(camera.project(behind), None);
        }
    }
}

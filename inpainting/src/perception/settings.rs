//! Settings of a perception, and the quantities derived from them.

use glam::DVec3;

use crate::calibration::CameraCalibration;
use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, require_nonnegative_metres, require_that};
use crate::inpainter::InpainterSettings;
use crate::links::ArmLink;
use crate::mark::GripperMark;

/// Maximum number of in-painting pixels along each side of a pixel of the policy.
const MAX_OVERSAMPLING: usize = 15;
/// Largest deviation of a component of the policy camera's optical axis from straight down.
const AXIS_TOLERANCE: f64 = 1e-9;

/// Settings of a [`Perception`](crate::Perception).
#[derive(Clone, Debug, PartialEq)]
pub struct PerceptionSettings {
    /// Calibration of the real camera.
    pub calibration: CameraCalibration,
    /// Camera of the policy's observations. It looks straight down on the table, the plane z = 0.
    pub policy_camera: PinholeCamera,
    /// Number of in-painting pixels along each side of a pixel of the policy: odd, at most 15.
    pub oversampling: usize,
    /// Links of the arm to paint out.
    pub arm_links: Vec<ArmLink>,
    /// Margin (metres) by which the mask exceeds the links, for errors of calibration, joint
    /// positions and timing.
    pub mask_margin_m: f64,
    /// Colour correction to the policy's picture of the table.
    pub colour_correction: ColorCorrection,
    /// Mark that is drawn over the gripper, as in the policy's training.
    pub gripper_mark: GripperMark,
}

impl PerceptionSettings {
    pub(super) fn check(&self) -> Result<(), InpaintingError> {
        self.calibration.check()?;
        self.policy_camera.check()?;
        self.gripper_mark.check()?;
        // the median of an odd number of values is one of them
        let odd = self.oversampling % 2 == 1 && self.oversampling <= MAX_OVERSAMPLING;
        require_that(odd, "oversampling", &self.oversampling, "an odd number, 15 at most")?;
        require_nonnegative_metres("mask_margin_m", self.mask_margin_m)?;
        let down = self.policy_camera.extrinsics.rotation.transpose().z_axis;
        let straight = down.abs_diff_eq(DVec3::NEG_Z, AXIS_TOLERANCE);
        require_that(straight, "policy's view", &down, "straight down, [0, 0, -1]")?;
        for (name, camera) in [
            ("height of the policy's camera", &self.policy_camera.extrinsics),
            ("height of the camera", &self.calibration.extrinsics),
        ] {
            let height = camera.camera_position().z;
            require_that(height > 0.0, name, &height, "a positive number of metres")?;
        }
        Ok(())
    }

    /// Returns a camera at the real one's position that looks straight down and shows each point of
    /// the table where the policy's camera shows it.
    pub(super) fn rectified_camera(&self) -> Result<PinholeCamera, InpaintingError> {
        let Extrinsics { rotation, .. } = self.policy_camera.extrinsics;
        let (from, to) =
            (self.policy_camera.extrinsics.camera_position(), self.calibration.camera_position());
        let inside = self.policy_camera.intrinsics;
        let finer = self.oversampling as f64;
        let scale = inside.focal_lengths.map(|focal| finer * focal / from.z);
        // shifts the principal point so that the table does not move in the picture
        let away = (rotation * (from - to)).to_array();
        let size = [inside.width, inside.height].map(|side| side.checked_mul(self.oversampling));
        let [width, height] = size.map(Option::unwrap_or_default);
        let view = PinholeCamera {
            intrinsics: Intrinsics {
                width,
                height,
                focal_lengths: scale.map(|scale| scale * to.z),
                principal_point: [0, 1]
                    .map(|axis| finer * inside.principal_point[axis] - scale[axis] * away[axis]),
            },
            extrinsics: Extrinsics { rotation, translation: -(rotation * to) },
        };
        view.check()?;
        Ok(view)
    }

    /// Returns the settings of the in-painter for the rectified pictures of `camera`.
    pub(super) fn inpainter_settings(&self, camera: PinholeCamera) -> InpainterSettings {
        let links = self
            .arm_links
            .iter()
            .map(|link| ArmLink { radius: link.radius + self.mask_margin_m, ..*link });
        InpainterSettings {
            camera,
            arm_links: links.collect(),
            colour_correction: self.colour_correction,
            // drawn last, in the policy's own pixels
            gripper_mark: GripperMark { outer_radius: 0.0, hole_radius: 0.0, ..self.gripper_mark },
        }
    }

    /// Upsamples one of the policy's pictures, each pixel to a square of in-painting pixels.
    pub(super) fn upsampled(&self, picture: &[u8]) -> Vec<u8> {
        let Intrinsics { width, height, .. } = self.policy_camera.intrinsics;
        let finer = self.oversampling;
        let pixels = (0..finer * height).flat_map(|row| {
            let line = &picture[3 * width * (row / finer)..][..3 * width];
            let wide = line.chunks_exact(3);
            wide.flat_map(move |pixel| std::iter::repeat_n(pixel, finer))
        });
        pixels.flatten().copied().collect()
    }

    /// Downsamples a picture to the policy's pixels, by the median of each square of in-painting
    /// pixels.
    pub(super) fn downsample(&self, painted: &[u8], out: &mut [u8]) {
        let (width, finer) = (self.policy_camera.intrinsics.width, self.oversampling);
        let line = 3 * width * finer;
        let mut values = [0; MAX_OVERSAMPLING * MAX_OVERSAMPLING];
        let values = &mut values[..finer * finer];
        for (index, value) in out.iter_mut().enumerate() {
            let (pixel, channel) = (index / 3, index % 3);
            let corner = pixel / width * finer * line + pixel % width * finer * 3 + channel;
            for (i, sample) in values.iter_mut().enumerate() {
                *sample = painted[corner + i / finer * line + i % finer * 3];
            }
            *value = *values.select_nth_unstable(finer * finer / 2).1;
        }
    }
}

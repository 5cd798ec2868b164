//! Settings of a perception, and the quantities derived from them.

use glam::DVec3;

use crate::calibration::Calibration;
use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, require, require_length};
use crate::inpainter::InpainterSettings;
use crate::links::Link;
use crate::mark::Mark;

/// Maximum oversampling.
const MAX_OVERSAMPLING: usize = 15;
/// Largest deviation of a component of the policy camera's axis from straight down.
const AXIS_TOLERANCE: f64 = 1e-9;

/// Settings of a [`Perception`](crate::Perception).
#[derive(Clone, Debug, PartialEq)]
pub struct PerceptionSettings {
    /// Calibration of the real camera.
    pub calibration: Calibration,
    /// Camera of the policy's observations. It looks straight down on the table, the plane z = 0.
    pub policy: PinholeCamera,
    /// Number of in-painting pixels along each side of a pixel of the policy: odd, at most 15.
    pub oversampling: usize,
    /// Links of the arm to paint out.
    pub links: Vec<Link>,
    /// Margin (metres) by which the mask exceeds the links, for errors of calibration, joint
    /// positions and timing.
    pub growth: f64,
    /// Colour correction to the policy's picture of the table.
    pub correction: ColorCorrection,
    /// Mark over the gripper, as in the policy's training.
    pub mark: Mark,
}

impl PerceptionSettings {
    pub(super) fn check(&self) -> Result<(), InpaintingError> {
        self.calibration.check()?;
        self.policy.check()?;
        self.mark.check()?;
        // the median of an odd number of values is one of them
        let odd = self.oversampling % 2 == 1 && self.oversampling <= MAX_OVERSAMPLING;
        require(odd, "oversampling", &self.oversampling, "an odd number, 15 at most")?;
        require_length("growth", self.growth)?;
        let down = self.policy.extrinsics.rotation.transpose().z_axis;
        let straight = down.abs_diff_eq(DVec3::NEG_Z, AXIS_TOLERANCE);
        require(straight, "policy's view", &down, "straight down, [0, 0, -1]")?;
        for (name, camera) in [
            ("height of the policy's camera", &self.policy.extrinsics),
            ("height of the camera", &self.calibration.extrinsics),
        ] {
            let height = camera.position().z;
            require(height > 0.0, name, &height, "a positive number of metres")?;
        }
        Ok(())
    }

    /// Returns a camera at the real one's position that looks straight down and shows each point of
    /// the table where the policy's camera shows it.
    pub(super) fn view(&self) -> Result<PinholeCamera, InpaintingError> {
        let Extrinsics { rotation, .. } = self.policy.extrinsics;
        let (from, to) = (self.policy.extrinsics.position(), self.calibration.position());
        let inside = self.policy.intrinsics;
        let finer = self.oversampling as f64;
        let scale = inside.focal.map(|focal| finer * focal / from.z);
        // shifts the principal point so that the table does not move in the picture
        let away = (rotation * (from - to)).to_array();
        let size = [inside.width, inside.height].map(|side| side.checked_mul(self.oversampling));
        let [width, height] = size.map(Option::unwrap_or_default);
        let view = PinholeCamera {
            intrinsics: Intrinsics {
                width,
                height,
                focal: scale.map(|scale| scale * to.z),
                centre: [0, 1].map(|axis| finer * inside.centre[axis] - scale[axis] * away[axis]),
            },
            extrinsics: Extrinsics { rotation, translation: -(rotation * to) },
        };
        view.check()?;
        Ok(view)
    }

    /// Returns the settings of the in-painter for the rectified pictures of `camera`.
    pub(super) fn inpainter(&self, camera: PinholeCamera) -> InpainterSettings {
        let links =
            self.links.iter().map(|link| Link { radius: link.radius + self.growth, ..*link });
        InpainterSettings {
            camera,
            links: links.collect(),
            correction: self.correction,
            // drawn last, in the policy's own pixels
            mark: Mark { radius: 0.0, hole: 0.0, ..self.mark },
        }
    }

    /// Upsamples one of the policy's pictures, each pixel to a square of in-painting pixels.
    pub(super) fn upsampled(&self, picture: &[u8]) -> Vec<u8> {
        let Intrinsics { width, height, .. } = self.policy.intrinsics;
        let finer = self.oversampling;
        let pixels = (0..finer * height).flat_map(|row| {
            let line = &picture[3 * width * (row / finer)..][..3 * width];
            let wide = line.chunks_exact(3);
            wide.flat_map(move |pixel| std::iter::repeat_n(pixel, finer))
        });
        pixels.flatten().copied().collect()
    }

    /// Downsamples to the policy's pixels, by the median of each square of in-painting pixels.
    pub(super) fn downsample(&self, painted: &[u8], out: &mut [u8]) {
        let (width, finer) = (self.policy.intrinsics.width, self.oversampling);
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

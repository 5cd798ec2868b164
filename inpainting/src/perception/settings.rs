//! What a perception knows beforehand, and what follows from that.

use glam::DVec3;

use crate::calibration::Calibration;
use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, require, require_length};
use crate::inpainter::InpainterSettings;
use crate::links::Link;
use crate::mark::Mark;

/// Most pixels along the side of a pixel of the policy's.
const FINEST: usize = 15;
/// How far the policy's camera may be from looking straight down.
const STRAIGHT: f64 = 1e-9;

/// What a [`Perception`](crate::Perception) knows beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct PerceptionSettings {
    /// What is known of the camera.
    pub calibration: Calibration,
    /// The camera whose pictures the policy knows. It looks straight down on the table, which is
    /// the plane z = 0.
    pub policy: PinholeCamera,
    /// Pixels that the arm is painted out in along each side of a pixel of the policy's; an odd
    /// number, 15 at most.
    pub oversampling: usize,
    /// The arm's links.
    pub links: Vec<Link>,
    /// How much thicker the mask is than the links (metres): calibrations, joints and times are
    /// never exact.
    pub growth: f64,
    /// How colours are corrected.
    pub correction: ColorCorrection,
    /// The mark over the gripper, as the policy knows it.
    pub mark: Mark,
}

impl PerceptionSettings {
    pub(super) fn check(&self) -> Result<(), InpaintingError> {
        self.calibration.check()?;
        self.policy.check()?;
        self.mark.check()?;
        let odd = self.oversampling % 2 == 1 && self.oversampling <= FINEST;
        let expected = "an odd number, 15 at most";
        require(odd, "oversampling", &self.oversampling, expected)?;
        require_length("growth", self.growth)?;
        let down = self.policy.extrinsics.rotation.transpose().z_axis;
        let straight = down.abs_diff_eq(DVec3::NEG_Z, STRAIGHT);
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

    /// A camera where the real one is, which looks straight down and shows the table in the places
    /// in which the policy's camera shows it.
    pub(super) fn view(&self) -> Result<PinholeCamera, InpaintingError> {
        let Extrinsics { rotation, .. } = self.policy.extrinsics;
        let (from, to) = (self.policy.extrinsics.position(), self.calibration.position());
        let inside = self.policy.intrinsics;
        let finer = self.oversampling as f64;
        let scale = inside.focal.map(|focal| finer * focal / from.z);
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

    /// Each pixel of the policy's as a square of the in-painting's.
    pub(super) fn enlarged(&self, picture: &[u8]) -> Vec<u8> {
        let Intrinsics { width, height, .. } = self.policy.intrinsics;
        let finer = self.oversampling;
        let pixels = (0..finer * height).flat_map(|row| {
            let line = &picture[3 * width * (row / finer)..][..3 * width];
            let wide = line.chunks_exact(3);
            wide.flat_map(move |pixel| std::iter::repeat_n(pixel, finer))
        });
        pixels.flatten().copied().collect()
    }

    /// The median of each square of the in-painting's pixels.
    pub(super) fn shrink(&self, painted: &[u8], out: &mut [u8]) {
        let (width, finer) = (self.policy.intrinsics.width, self.oversampling);
        let line = 3 * width * finer;
        let mut values = [0; FINEST * FINEST];
        let values = &mut values[..finer * finer];
        for (index, value) in out.iter_mut().enumerate() {
            let (pixel, channel) = (index / 3, index % 3);
            let corner = pixel / width * finer * line + pixel % width * finer * 3 + channel;
            for (i, value) in values.iter_mut().enumerate() {
                *value = painted[corner + i / finer * line + i % finer * 3];
            }
            *value = *values.select_nth_unstable(finer * finer / 2).1;
        }
    }
}

//! What a deployment needs to know of how pictures are made.

use envs::Camera;
use inpainting::{Calibration, ColorCorrection, Link, Mark, PerceptionSettings, PinholeCamera};

/// How a real camera's pictures become those that policies know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightSettings {
    /// How much thicker the mask is than the arm (metres).
    pub growth: f64,
    /// Pixels that the arm is painted out in along each side of a pixel that is drawn for a policy;
    /// odd.
    pub oversampling: usize,
    /// How colours are corrected.
    pub correction: ColorCorrection,
    /// The camera, where somebody knows more of it than the rig does.
    pub calibration: Option<Calibration>,
}

impl Default for SightSettings {
    /// A mask that hides the arm where the calibration is wrong by 5 mm and half a degree.
    fn default() -> Self {
        Self {
            growth: 0.02,
            oversampling: 3,
            correction: ColorCorrection::GreyWorld,
            calibration: None,
        }
    }
}

impl SightSettings {
    /// The perception of an arm of capsules with these radii, two joints for each, for a policy that
    /// has learnt with `camera`: of the pictures that observations are made of, without the mark.
    pub(super) fn perception(
        &self,
        calibration: Calibration,
        camera: &Camera,
        radii: impl Iterator<Item = f64>,
    ) -> PerceptionSettings {
        let link =
            |(index, radius): (usize, f64)| Link { joints: [2 * index, 2 * index + 1], radius };
        PerceptionSettings {
            calibration,
            policy: pinhole(&camera.with_size(camera.drawn_size())),
            oversampling: self.oversampling,
            links: radii.enumerate().map(link).collect(),
            growth: self.growth,
            correction: self.correction,
            mark: Mark::disc(0.0, camera.mark.color, camera.height),
        }
    }
}

/// A camera of the environments as one of in-painting.
fn pinhole(camera: &Camera) -> PinholeCamera {
    PinholeCamera::overhead(camera.size, camera.height, camera.half_extent)
}

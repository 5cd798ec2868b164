//! Settings of the perception, and of a simulated rig with it.

use envs::Camera;
use inpainting::{
    ArmLink, CameraCalibration, ColorCorrection, GripperMark, PerceptionSettings, PinholeCamera,
};

use super::simulated::SimulatedRigSettings;

/// Settings of the perception, which makes a real camera's pictures look like those of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisionSettings {
    /// Margin of the mask around the arm (metres).
    pub mask_margin_m: f64,
    /// Number of in-painted pixels along each side of a pixel of the picture for a policy; odd.
    pub oversampling: usize,
    /// Method by which the colours of the camera's pictures are corrected.
    pub colour_correction: ColorCorrection,
    /// Calibration that replaces the rig's own; `None` to use the rig's.
    pub calibration: Option<CameraCalibration>,
}

/// Settings of a simulated rig and of the perception of its pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigAndVisionSettings {
    /// Faults of the simulated camera and the simulated arm.
    pub simulation: SimulatedRigSettings,
    /// Settings of the perception of the rig's pictures.
    pub vision: VisionSettings,
}

impl RigAndVisionSettings {
    /// Settings without faults and with the default perception.
    pub const NO_FAULTS: Self =
        Self { simulation: SimulatedRigSettings::NO_FAULTS, vision: VisionSettings::DEFAULT };
    /// Settings with faults about as large as those of real robots and cameras, and the default
    /// perception.
    pub const NOMINAL_FAULTS: Self =
        Self { simulation: SimulatedRigSettings::NOMINAL_FAULTS, vision: VisionSettings::DEFAULT };
}

impl Default for VisionSettings {
    /// Returns settings whose mask hides the arm if the calibration is wrong by 5 mm and 0.5
    /// degrees.
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl VisionSettings {
    const DEFAULT: Self = Self {
        mask_margin_m: 0.02,
        oversampling: 3,
        colour_correction: ColorCorrection::GreyWorld,
        calibration: None,
    };

    /// Returns the settings of the perception for an arm of capsules with these radii (metres),
    /// whose ends are listed in the same order, two for each, and for a policy that was trained
    /// with `camera`. Pictures have the size at which observations are drawn, and no mark.
    pub(super) fn perception_settings(
        &self,
        calibration: CameraCalibration,
        camera: &Camera,
        radii: impl Iterator<Item = f64>,
    ) -> PerceptionSettings {
        let link = |(index, radius): (usize, f64)| ArmLink {
            end_joints: [2 * index, 2 * index + 1],
            radius,
        };
        PerceptionSettings {
            calibration,
            policy_camera: pinhole(&camera.with_size(camera.rendered_size())),
            oversampling: self.oversampling,
            arm_links: radii.enumerate().map(link).collect(),
            mask_margin_m: self.mask_margin_m,
            colour_correction: self.colour_correction,
            gripper_mark: GripperMark::disc(0.0, camera.mark.color, camera.height),
        }
    }
}

/// Converts a camera of the environments to one of the crate `inpainting`.
fn pinhole(camera: &Camera) -> PinholeCamera {
    PinholeCamera::overhead(camera.size, camera.height, camera.half_extent)
}

//! Pictures in which an arm was painted out: what it hides stays as it was last seen.

use glam::DVec3;
use inpainting::{
    ArmLink, ColorCorrection, GripperMark, Inpainter, InpainterSettings, PinholeCamera,
};
use robots::Capsule;

use crate::camera::Camera;
use crate::error::EnvError;

/// Distance by which the painted area exceeds the arm (metres), as on a robot.
const MARGIN: f64 = 0.02;

/// Occlusion by the arm in the pictures of an episode.
#[derive(Clone, Debug)]
pub(crate) enum ArmOcclusion {
    /// Arm that hides nothing.
    Off,
    /// Arm that hides objects after the first picture, which is still to come and shows all of them.
    Pending,
    /// Arm that hides objects, with the memory that replaces them.
    Active(Box<PictureMemory>),
}

/// Memory of an episode's pictures, which replaces what the arm hides.
#[derive(Clone, Debug)]
pub(crate) struct PictureMemory {
    inpainter: Inpainter,
    /// Picture before the arm is painted out, `[rendered_size, rendered_size, 3]`.
    scratch: Vec<u8>,
}

impl PictureMemory {
    /// Begins an episode with `rendered` `[rendered_size, rendered_size, 3]`, a picture of `camera`
    /// without the arm, and with the capsules of the arm (metres, world frame).
    ///
    /// # Errors
    /// [`EnvError::Inpainting`].
    pub fn new(camera: &Camera, capsules: &[Capsule], rendered: &[u8]) -> Result<Self, EnvError> {
        let size = camera.rendered_size();
        let link = |(index, capsule): (usize, &Capsule)| ArmLink {
            end_joints: [2 * index, 2 * index + 1],
            radius: capsule.radius + MARGIN,
        };
        let settings = InpainterSettings {
            camera: PinholeCamera::overhead(size, camera.height, camera.half_extent),
            arm_links: capsules.iter().enumerate().map(link).collect(),
            colour_correction: ColorCorrection::None,
            // the renderer draws the mark later, in observed pixels
            gripper_mark: GripperMark::disc(0.0, camera.mark.color, camera.height),
        };
        let inpainter = Inpainter::new(settings, rendered)?;
        Ok(Self { inpainter, scratch: rendered.to_vec() })
    }

    /// Replaces what the arm hides in `rendered` `[rendered_size, rendered_size, 3]` by what was
    /// there when it was last seen, given the capsules in the order of [`PictureMemory::new`].
    ///
    /// # Errors
    /// [`EnvError::Inpainting`].
    pub fn apply(&mut self, capsules: &[Capsule], rendered: &mut [u8]) -> Result<(), EnvError> {
        self.scratch.copy_from_slice(rendered);
        let ends: Vec<DVec3> = capsules.iter().flat_map(|capsule| capsule.ends).collect();
        Ok(self.inpainter.inpaint(&self.scratch, &ends, DVec3::ZERO, rendered)?)
    }
}

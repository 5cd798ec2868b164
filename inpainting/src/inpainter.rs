//! The pipeline: mask, colours, memory, mark.

use glam::DVec3;

use crate::camera::{NEAR, PinholeCamera, is_near};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, check_picture, require};
use crate::links::{Capsule, Link};
use crate::mark::Mark;

/// What an [`Inpainter`] knows beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct InpainterSettings {
    /// The camera.
    pub camera: PinholeCamera,
    /// The arm's links.
    pub links: Vec<Link>,
    /// How colours are corrected.
    pub correction: ColorCorrection,
    /// The mark over the gripper.
    pub mark: Mark,
}

/// Paints an arm out of one episode's frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Inpainter {
    settings: InpainterSettings,
    /// The table before the arm came.
    reference: Vec<u8>,
    /// The table as last seen.
    background: Vec<u8>,
    corrected: Vec<u8>,
    mask: Vec<bool>,
}

impl Inpainter {
    /// An in-painter that starts from `background` `[H, W, 3]`: the camera's picture of the table
    /// without the arm.
    ///
    /// # Errors
    /// [`InpaintingError::Value`], [`InpaintingError::Length`].
    pub fn new(settings: InpainterSettings, background: &[u8]) -> Result<Self, InpaintingError> {
        settings.check()?;
        let pixels = settings.camera.pixels();
        check_picture("background", background, pixels)?;
        Ok(Self {
            settings,
            reference: background.to_vec(),
            background: background.to_vec(),
            corrected: background.to_vec(),
            mask: vec![false; pixels],
        })
    }

    /// Paints the arm out of `image` `[H, W, 3]`, given the positions of its joints and of the
    /// gripper (metres, world frame), into `out` of the same shape.
    ///
    /// # Errors
    /// [`InpaintingError::Length`]; [`InpaintingError::Value`] for a link without its joints, or a
    /// position that is not finite or farther than 1e9 m from the origin. After an error nothing
    /// has changed.
    pub fn inpaint(
        &mut self,
        image: &[u8],
        joints: &[DVec3],
        gripper: DVec3,
        out: &mut [u8],
    ) -> Result<(), InpaintingError> {
        check_picture("image", image, self.mask.len())?;
        check_picture("out", out, self.mask.len())?;
        self.check_positions(joints, gripper)?;
        self.mask_arm(joints);
        self.refresh(image);
        out.copy_from_slice(&self.background);
        self.settings.mark.draw(&self.settings.camera, gripper, out);
        Ok(())
    }

    /// What it knows beforehand.
    pub fn settings(&self) -> &InpainterSettings {
        &self.settings
    }

    /// Where the last frame's arm was, `[H, W]`.
    pub fn mask(&self) -> &[bool] {
        &self.mask
    }

    fn check_positions(&self, joints: &[DVec3], gripper: DVec3) -> Result<(), InpaintingError> {
        let index = joints.iter().position(|joint| !is_near(*joint));
        let value = index.map_or_else(String::new, |i| format!("{} at {i}", joints[i]));
        require(index.is_none(), "joint positions", &value, NEAR)?;
        require(is_near(gripper), "gripper position", &gripper, NEAR)?;
        let ends = self.settings.links.iter().flat_map(|link| link.joints);
        let last = ends.max().unwrap_or(0);
        let known = last < joints.len() || self.settings.links.is_empty();
        let expected = "an index below the number of joints";
        require(known, "joint of a link", &last, expected)
    }

    fn mask_arm(&mut self, joints: &[DVec3]) {
        self.mask.fill(false);
        let camera = &self.settings.camera;
        for link in &self.settings.links {
            let capsule = Capsule {
                ends: link.joints.map(|joint| camera.in_camera(joints[joint])),
                radius: link.radius,
            };
            capsule.mark(camera, &mut self.mask);
        }
    }

    /// Takes into the background what of `image` is not hidden, in corrected colours.
    fn refresh(&mut self, image: &[u8]) {
        self.corrected.copy_from_slice(image);
        let correction = self.settings.correction;
        correction.apply(&self.reference, &self.mask, &mut self.corrected);
        let pixels = self.background.chunks_exact_mut(3);
        for ((old, new), &hidden) in pixels.zip(self.corrected.chunks_exact(3)).zip(&self.mask) {
            if !hidden {
                old.copy_from_slice(new);
            }
        }
    }
}

impl InpainterSettings {
    fn check(&self) -> Result<(), InpaintingError> {
        self.camera.check()?;
        self.mark.check()?;
        self.links.iter().try_for_each(|link| {
            let thick = link.radius >= 0.0 && link.radius.is_finite();
            require(thick, "link radius", &link.radius, "a length in metres")
        })
    }
}

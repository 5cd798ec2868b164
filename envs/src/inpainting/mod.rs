//! In-painting: a picture of a table with an arm over it becomes one without the arm, with a mark at the gripper.
//!
//! Source: the paper's appendix "Image Inpainting". It needs a calibrated camera ([`View`]), a picture of the table without the arm, and for
//! every frame the positions of the arm's joints. It knows no simulation, so a real camera and arm can feed it; [`Skeleton`] takes
//! joints from this crate's scenes.
//!
//! Each frame: the capsules between the joints are masked; colours are corrected ([`Correction`]); the background is refreshed outside the mask;
//! the result is the background with the mark over it. What moves under the arm is seen where it was last seen.
//!
//! ```
//! use envs::{Mark, inpainting::{Correction, Extrinsics, Inpainter, Inpainting, Intrinsics, Limb, View}};
//! use glam::{DMat3, DVec3};
//!
//! # fn main() -> Result<(), envs::EnvError> {
//! let view = View {
//!     intrinsics: Intrinsics { width: 64, height: 48, focal: [60.0, 60.0], centre: [32.0, 24.0] },
//!     // straight down from 1.2 m
//!     extrinsics: Extrinsics {
//!         rotation: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
//!         translation: DVec3::new(0.0, 0.0, 1.2),
//!     },
//! };
//! let limbs = vec![Limb { joints: [0, 1], radius: 0.05 }, Limb { joints: [1, 2], radius: 0.04 }];
//! let settings = Inpainting { view, limbs, correction: Correction::GreyWorld, mark: Mark::default(), mark_depth: 1.2 };
//! let (background, frame) = (vec![90; 64 * 48 * 3], vec![80; 64 * 48 * 3]);
//! let joints = [DVec3::new(0.0, -0.4, 0.2), DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.0, 0.0, 0.1)];
//! let mut inpainter = Inpainter::new(settings, &background)?;
//! let mut result = vec![0; frame.len()];
//! inpainter.inpaint(&frame, &joints, joints[2], &mut result)?;
//! assert_eq!(result[..3], [90; 3], "darker by the light alone");
//! # Ok(())
//! # }
//! ```

mod color;
mod limbs;
mod skeleton;
mod view;

use glam::DVec3;

use crate::EnvError;
use crate::camera::{Mark, draw_ring, require};

pub use color::Correction;
pub use limbs::Limb;
pub use skeleton::Skeleton;
pub use view::{Extrinsics, Intrinsics, View};

use limbs::Capsule;

/// What an [`Inpainter`] knows beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct Inpainting {
    /// The camera.
    pub view: View,
    /// The arm's links.
    pub limbs: Vec<Limb>,
    /// How colours are corrected.
    pub correction: Correction,
    /// The mark over the gripper; its radii are lengths at `mark_depth`.
    pub mark: Mark,
    /// Distance from the camera at which the mark has its size (metres): that of the table.
    pub mark_depth: f64,
}

/// Paints an arm out of one episode's frames.
#[derive(Clone, Debug)]
pub struct Inpainter {
    settings: Inpainting,
    /// The table before the arm came.
    reference: Vec<u8>,
    /// The table as last seen.
    background: Vec<u8>,
    corrected: Vec<u8>,
    mask: Vec<bool>,
}

impl Inpainter {
    /// An in-painter that starts from `background` `[H, W, 3]`: the camera's picture of the table without the arm.
    ///
    /// # Errors
    /// [`EnvError::Setting`], [`EnvError::Length`].
    pub fn new(settings: Inpainting, background: &[u8]) -> Result<Self, EnvError> {
        settings.check()?;
        let pixels = settings.view.pixels();
        check_picture("background", background, pixels)?;
        Ok(Self {
            settings,
            reference: background.to_vec(),
            background: background.to_vec(),
            corrected: background.to_vec(),
            mask: vec![false; pixels],
        })
    }

    /// Paints the arm out of `image` `[H, W, 3]`, given the positions of its joints and of the gripper (metres, world frame), into `out` of the
    /// same shape.
    ///
    /// # Errors
    /// [`EnvError::Length`]; [`EnvError::Setting`] for a limb without its joints or a position that is not finite.
    pub fn inpaint(
        &mut self,
        image: &[u8],
        joints: &[DVec3],
        gripper: DVec3,
        out: &mut [u8],
    ) -> Result<(), EnvError> {
        check_picture("image", image, self.mask.len())?;
        check_picture("out", out, self.mask.len())?;
        self.find_arm(joints)?;
        self.corrected.copy_from_slice(image);
        let correction = self.settings.correction;
        correction.apply(&self.reference, &self.mask, &mut self.corrected);
        let pixels = self.background.chunks_exact_mut(3);
        for ((old, new), &hidden) in pixels.zip(self.corrected.chunks_exact(3)).zip(&self.mask) {
            if !hidden {
                old.copy_from_slice(new);
            }
        }
        out.copy_from_slice(&self.background);
        self.draw_mark(gripper, out)
    }

    /// Where the last frame's arm was, `[H, W]`.
    pub fn mask(&self) -> &[bool] {
        &self.mask
    }

    fn find_arm(&mut self, joints: &[DVec3]) -> Result<(), EnvError> {
        let finite = joints.iter().all(|joint| joint.is_finite());
        require(finite, "joint positions", &"not finite", FINITE)?;
        self.mask.fill(false);
        let view = &self.settings.view;
        for limb in &self.settings.limbs {
            let last = limb.joints[0].max(limb.joints[1]);
            let known = last < joints.len();
            require(
                known,
                "joint of a limb",
                &last,
                "an index below the number of joints",
            )?;
            let capsule = Capsule {
                ends: limb.joints.map(|joint| view.in_camera(joints[joint])),
                radius: limb.radius,
            };
            capsule.mark(view, &mut self.mask);
        }
        Ok(())
    }

    fn draw_mark(&self, gripper: DVec3, out: &mut [u8]) -> Result<(), EnvError> {
        require(gripper.is_finite(), "gripper position", &gripper, FINITE)?;
        let Inpainting {
            view,
            mark,
            mark_depth,
            ..
        } = &self.settings;
        let Intrinsics {
            width,
            focal,
            centre,
            ..
        } = view.intrinsics;
        if let Some(offset) = view.project(gripper) {
            let radii = [mark.radius, mark.hole].map(|radius| radius * focal[0] / mark_depth);
            draw_ring(centre, offset, radii, mark.color, width, out);
        }
        Ok(())
    }
}

const FINITE: &str = "finite numbers of metres";

impl Inpainting {
    fn check(&self) -> Result<(), EnvError> {
        self.view.check()?;
        self.mark.check()?;
        let ahead = self.mark_depth > 0.0 && self.mark_depth.is_finite();
        require(
            ahead,
            "mark depth",
            &self.mark_depth,
            "a positive length in metres",
        )?;
        self.limbs.iter().try_for_each(|limb| {
            let thick = limb.radius >= 0.0 && limb.radius.is_finite();
            require(thick, "limb radius", &limb.radius, "a length in metres")
        })
    }
}

fn check_picture(what: &'static str, picture: &[u8], pixels: usize) -> Result<(), EnvError> {
    if picture.len() == 3 * pixels {
        return Ok(());
    }
    Err(EnvError::Length {
        what,
        got: picture.len(),
        expected: 3 * pixels,
    })
}

#[cfg(test)]
mod tests;

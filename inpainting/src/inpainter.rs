//! In-painting pipeline: mask the arm, correct colours, update the background, draw the gripper's
//! mark.

use glam::DVec3;

use crate::camera::{
    PinholeCamera, VALID_COORDINATES, has_valid_coordinates, require_valid_coordinates,
};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, check_picture_size, require_nonnegative_metres, require_that};
use crate::links::{ArmLink, Capsule};
use crate::mark::GripperMark;

/// Settings of an [`Inpainter`].
#[derive(Clone, Debug, PartialEq)]
pub struct InpainterSettings {
    /// Camera that takes the pictures.
    pub camera: PinholeCamera,
    /// Links of the arm to paint out.
    pub arm_links: Vec<ArmLink>,
    /// Colour correction of each frame to the first background.
    pub colour_correction: ColorCorrection,
    /// Mark that is drawn over the gripper.
    pub gripper_mark: GripperMark,
}

/// In-painter that removes an arm from the frames of one episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Inpainter {
    settings: InpainterSettings,
    /// Picture of the table without the arm, `[height, width, 3]`.
    reference: Vec<u8>,
    /// Each pixel of the table as last seen, `[height, width, 3]`.
    background: Vec<u8>,
    /// Last camera frame in corrected colours, `[height, width, 3]`.
    corrected: Vec<u8>,
    /// Pixels that the arm hides in the last camera frame, `[height, width]`.
    mask: Vec<bool>,
}

impl Inpainter {
    /// Creates an in-painter from `background` `[height, width, 3]`, the camera's picture of the
    /// table without the arm.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`], [`InpaintingError::WrongLength`].
    pub fn new(settings: InpainterSettings, background: &[u8]) -> Result<Self, InpaintingError> {
        settings.check()?;
        let pixels = settings.camera.num_pixels();
        check_picture_size("background", background, pixels)?;
        Ok(Self {
            settings,
            reference: background.to_vec(),
            background: background.to_vec(),
            corrected: background.to_vec(),
            mask: vec![false; pixels],
        })
    }

    /// Writes `image` `[height, width, 3]` without the arm and with the gripper's mark into `out`
    /// of the same shape, given the positions of the arm's joints and of the gripper (metres, world
    /// frame).
    ///
    /// # Errors
    /// [`InpaintingError::WrongLength`]; [`InpaintingError::InvalidValue`] for a link without its
    /// joints, or a position that is not finite or has a coordinate beyond 1e9 m. The in-painter is
    /// unchanged then.
    pub fn inpaint(
        &mut self,
        image: &[u8],
        joints: &[DVec3],
        gripper: DVec3,
        out: &mut [u8],
    ) -> Result<(), InpaintingError> {
        check_picture_size("image", image, self.mask.len())?;
        check_picture_size("out", out, self.mask.len())?;
        self.check_positions(joints, gripper)?;
        self.mask_arm(joints);
        self.refresh(image);
        out.copy_from_slice(&self.background);
        self.settings.gripper_mark.draw(&self.settings.camera, gripper, out);
        Ok(())
    }

    /// Returns the settings of the in-painter.
    pub fn settings(&self) -> &InpainterSettings {
        &self.settings
    }

    /// Returns the mask of the last camera frame, `[height, width]`: `true` for pixels that the arm
    /// hides.
    pub fn arm_mask(&self) -> &[bool] {
        &self.mask
    }

    /// Returns for each pixel the largest difference of a channel (levels) between the last frame,
    /// in corrected colours, and the first background.
    pub fn difference_from_background(&self) -> impl Iterator<Item = u8> {
        let pixels = self.corrected.chunks_exact(3);
        let pairs = pixels.zip(self.reference.chunks_exact(3));
        pairs.map(|(now, before)| {
            let channels = now.iter().zip(before).map(|(a, b)| a.abs_diff(*b));
            channels.max().unwrap_or_default()
        })
    }

    /// Rejects positions out of range, and too few joints for the links.
    fn check_positions(&self, joints: &[DVec3], gripper: DVec3) -> Result<(), InpaintingError> {
        let index = joints.iter().position(|joint| !has_valid_coordinates(*joint));
        let value = index.map_or_else(String::new, |i| format!("{} at {i}", joints[i]));
        require_that(index.is_none(), "joint positions", &value, VALID_COORDINATES)?;
        require_valid_coordinates("gripper position", gripper)?;
        let ends = self.settings.arm_links.iter().flat_map(|link| link.end_joints);
        let last = ends.max().unwrap_or(0);
        let known = last < joints.len() || self.settings.arm_links.is_empty();
        let expected = "an index below the number of joints";
        require_that(known, "joint of a link", &last, expected)
    }

    /// Computes the mask of the arm from the positions of its joints.
    fn mask_arm(&mut self, joints: &[DVec3]) {
        self.mask.fill(false);
        let camera = &self.settings.camera;
        for link in &self.settings.arm_links {
            let capsule = Capsule {
                ends: link.end_joints.map(|joint| camera.world_to_camera(joints[joint])),
                radius: link.radius,
            };
            capsule.add_to_mask(camera, &mut self.mask);
        }
    }

    /// Copies the pixels of `image` that the arm does not hide, in corrected colours, into the
    /// background.
    fn refresh(&mut self, image: &[u8]) {
        self.corrected.copy_from_slice(image);
        let correction = self.settings.colour_correction;
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
        self.gripper_mark.check()?;
        let mut links = self.arm_links.iter();
        links.try_for_each(|link| require_nonnegative_metres("link radius", link.radius))
    }
}

/// `envs/tests/inpainting.rs` has the pipeline on a simulation.
#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::camera::tests::askew;
    use crate::mark::tests::MARK;

    fn settings() -> InpainterSettings {
        InpainterSettings {
            camera: askew(),
            arm_links: vec![ArmLink { end_joints: [0, 1], radius: 0.1 }],
            colour_correction: ColorCorrection::None,
            gripper_mark: MARK,
        }
    }

    /// Pixels outside the mask are updated; pixels behind the arm stay as last seen.
    #[test]
    fn the_background_is_refreshed_where_the_arm_is_not() {
        let mark = GripperMark { outer_radius: 0.0, ..MARK };
        let settings = InpainterSettings { gripper_mark: mark, ..settings() };
        let pixels = settings.camera.num_pixels();
        let mut inpainter = Inpainter::new(settings, &vec![10; 3 * pixels]).unwrap();
        let left = [DVec3::new(-0.3, -0.3, 0.0), DVec3::new(-0.3, 0.3, 0.0)];
        let right = left.map(|joint| DVec3::new(0.3, joint.y, joint.z));
        let mut out = vec![0; 3 * pixels];
        inpainter.inpaint(&vec![20; 3 * pixels], &left, DVec3::ZERO, &mut out).unwrap();
        let first = inpainter.arm_mask().to_vec();
        assert!(inpainter.difference_from_background().all(|levels| levels == 10));
        let hidden = first.iter().filter(|&&hidden| hidden).count();
        assert!(hidden > 50 && hidden < pixels / 2, "{hidden}");
        for (pixel, &is_hidden) in out.chunks_exact(3).zip(&first) {
            assert_eq!(pixel, if is_hidden { [10; 3] } else { [20; 3] });
        }
        inpainter.inpaint(&vec![30; 3 * pixels], &right, DVec3::ZERO, &mut out).unwrap();
        assert_ne!(inpainter.arm_mask(), first);
        for ((pixel, &now), &before) in out.chunks_exact(3).zip(inpainter.arm_mask()).zip(&first) {
            let seen = match (now, before) {
                (false, _) => 30,
                (true, false) => 20,
                (true, true) => 10,
            };
            assert_eq!(pixel, [seen; 3]);
        }
    }

    #[test]
    fn the_mark_stands_at_the_gripper() {
        let settings = settings();
        let (camera, pixels) = (settings.camera, settings.camera.num_pixels());
        let mut inpainter = Inpainter::new(settings, &vec![0; 3 * pixels]).unwrap();
        let gripper = DVec3::new(0.05, 0.1, 0.1);
        let mut out = vec![0; 3 * pixels];
        inpainter.inpaint(&vec![0; 3 * pixels], &[gripper; 2], gripper, &mut out).unwrap();
        let mut expected = vec![0; 3 * pixels];
        MARK.draw(&camera, gripper, &mut expected);
        assert!(out == expected && out.contains(&255));
    }

    #[test]
    fn nonsense_is_refused_with_its_value() {
        type Change = fn(&mut InpainterSettings);
        let broken: [(Change, &str); 10] = [
            (|s| s.camera.intrinsics.width = 0, "picture size` is 0 x 30"),
            (
                |s| s.camera.intrinsics.width = usize::MAX / 40,
                "picture size` is 461168601842738790 x 30",
            ),
            (|s| s.camera.extrinsics.translation.y = -1e200, "translation"),
            (|s| s.camera.intrinsics.focal_lengths[1] = -3.0, "focal length` is [35.0, -3.0]"),
            (|s| s.camera.intrinsics.principal_point[0] = f64::NAN, "optical axis"),
            (|s| s.camera.extrinsics.rotation = DMat3::ZERO, "rotation"),
            (|s| s.camera.extrinsics.translation.x = f64::INFINITY, "translation"),
            (|s| s.arm_links[0].radius = -0.1, "link radius` is -0.1"),
            (|s| s.gripper_mark.reference_depth = 0.0, "mark depth` is 0"),
            (|s| s.gripper_mark.hole_radius = 0.2, "mark hole` is 0.2"),
        ];
        for (change, says) in broken {
            let mut settings = settings();
            change(&mut settings);
            let message = Inpainter::new(settings, &[]).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
        let short = Inpainter::new(settings(), &[0; 7]).unwrap_err().to_string();
        assert!(short.contains("`background` has 7 elements, expected 3600"));
    }

    /// An error leaves the result, the mask and the background unchanged.
    #[test]
    fn what_cannot_be_painted_out_is_refused_and_changes_nothing() {
        let (dark, bright) = (vec![0; 3600], vec![200; 3600]);
        let mut inpainter = Inpainter::new(settings(), &dark).unwrap();
        let (zero, nan) = (DVec3::ZERO, DVec3::NAN);
        let far = DVec3::new(0.0, 1e200, 0.0);
        for (image, joints, gripper, length, says) in [
            (&[1, 2][..], &[zero; 2][..], zero, 3600, "`image` has 2"),
            (&bright, &[zero; 2], zero, 3597, "`out` has 3597 elements, expected 3600"),
            (&bright, &[zero], zero, 3600, "joint of a link` is 1"),
            (&bright, &[zero, nan], zero, 3600, "joint positions` is [NaN, NaN, NaN] at 1"),
            (&bright, &[zero; 2], nan, 3600, "gripper position"),
            (&bright, &[far, zero], zero, 3600, "joint positions"),
            (&bright, &[zero; 2], -far, 3600, "gripper position"),
        ] {
            let mut out = vec![0; length];
            let before = inpainter.clone();
            let refused = inpainter.inpaint(image, joints, gripper, &mut out);
            let message = refused.unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
            assert!(out.iter().all(|&level| level == 0), "{says}: the result was written");
            assert!(inpainter == before, "{says}: the refused picture is remembered");
        }
    }
}

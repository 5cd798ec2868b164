//! Conversion of a real camera's pictures to a policy's observations: rectified, cropped, without
//! the arm, in the colours of the training.

mod settings;

use glam::DVec3;

use crate::calibration::CameraCalibration;
use crate::camera::{Intrinsics, PinholeCamera};
use crate::error::{InpaintingError, check_picture_size};
use crate::inpainter::Inpainter;
use crate::warp::Warp;

pub use settings::PerceptionSettings;

/// Converter from a real camera's pictures of a table to a policy's observations.
///
/// It works in four steps. The picture is rectified: as if the camera, at its position, looked
/// straight down and showed the table where the policy's camera shows it. The arm is painted out
/// ([`Inpainter`]). Each of the policy's pixels becomes the median, channel by channel, of the
/// pixels in it. The mark is drawn where the policy's camera would see the gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct Perception {
    settings: PerceptionSettings,
    rectification: Warp,
    /// Picture of the empty table in the colours of the training, upsampled to the pixels of the
    /// in-painting.
    table: Vec<u8>,
    inpainter: Inpainter,
    rectified: Vec<u8>,
    painted: Vec<u8>,
}

impl Perception {
    /// Creates a perception from `table` `[height, width, 3]`, the policy's picture of the empty
    /// table, to whose colours every picture is corrected.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`], [`InpaintingError::WrongLength`];
    /// [`InpaintingError::OutOfSight`] if the camera does not see all that the policy's camera
    /// sees.
    pub fn new(settings: PerceptionSettings, table: &[u8]) -> Result<Self, InpaintingError> {
        settings.check()?;
        let view = settings.rectified_camera()?;
        check_picture_size("table", table, settings.policy_camera.num_pixels())?;
        let table = settings.upsampled(table);
        let inpainter = Inpainter::new(settings.inpainter_settings(view), &table)?;
        Ok(Self {
            rectification: rectification(&settings.calibration, &view)?,
            inpainter,
            rectified: vec![0; table.len()],
            painted: vec![0; table.len()],
            table,
            settings,
        })
    }

    /// Begins an episode with `frame`, the camera's picture of the table, its objects and the arm
    /// at `joints` (metres, world frame), as the background.
    ///
    /// The arm should hide no object: the area that it hides is filled with the empty table.
    ///
    /// # Errors
    /// Errors of [`Perception::observe`].
    pub fn begin_episode(&mut self, frame: &[u8], joints: &[DVec3]) -> Result<(), InpaintingError> {
        self.rectification.apply(frame, &mut self.rectified)?;
        let settings = self.inpainter.settings().clone();
        let mut empty = Inpainter::new(settings.clone(), &self.table)?;
        empty.inpaint(&self.rectified, joints, DVec3::ZERO, &mut self.painted)?;
        self.inpainter = Inpainter::new(settings, &self.painted)?;
        Ok(())
    }

    /// Writes the policy's observation of `frame`, the camera's picture, into `out`
    /// `[height, width, 3]`.
    ///
    /// `frame` was taken with the arm's joints at `joints` (metres, world frame). The mark is drawn
    /// at `gripper`, which may be a later position.
    ///
    /// # Errors
    /// Errors of [`Inpainter::inpaint`]. The background is unchanged then.
    pub fn observe(
        &mut self,
        frame: &[u8],
        joints: &[DVec3],
        gripper: DVec3,
        out: &mut [u8],
    ) -> Result<(), InpaintingError> {
        check_picture_size("out", out, self.settings.policy_camera.num_pixels())?;
        self.rectification.apply(frame, &mut self.rectified)?;
        self.inpainter.inpaint(&self.rectified, joints, gripper, &mut self.painted)?;
        self.settings.downsample(&self.painted, out);
        self.settings.gripper_mark.draw(&self.settings.policy_camera, gripper, out);
        Ok(())
    }

    /// Returns the settings of the perception.
    pub fn settings(&self) -> &PerceptionSettings {
        &self.settings
    }

    /// Returns the arm's mask in the last rectified picture, `[k height, k width]` for the height
    /// and width of the policy's pictures and the oversampling k.
    pub fn arm_mask(&self) -> &[bool] {
        self.inpainter.arm_mask()
    }

    /// Returns the last camera frame, rectified, `[k height, k width, 3]` with the oversampling k.
    pub fn rectified_frame(&self) -> &[u8] {
        &self.rectified
    }

    /// Returns the difference (levels) of each pixel of [`Perception::rectified_frame`], in
    /// corrected colours, from the picture at the start of the episode.
    pub fn difference_from_background(&self) -> impl Iterator<Item = u8> {
        self.inpainter.difference_from_background()
    }

    /// Returns the camera of the rectified pictures.
    pub fn rectified_camera(&self) -> &PinholeCamera {
        &self.inpainter.settings().camera
    }
}

fn rectification(
    calibration: &CameraCalibration,
    view: &PinholeCamera,
) -> Result<Warp, InpaintingError> {
    let Intrinsics { width, height, .. } = calibration.intrinsics;
    let across = view.intrinsics.width;
    let back = view.extrinsics.rotation.transpose();
    // a rotation about the camera's position maps rays, so the depth of the scene does not matter
    let place = |index| {
        calibration.project_world_direction(back * view.pixel_ray(index / across, index % across))
    };
    Warp::new([width, height], (0..view.num_pixels()).map(place))
}

/// Rectified pictures against the policy's own, and refusals.
#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::calibration::tests::overhead;
    use crate::camera::Extrinsics;
    use crate::color::ColorCorrection;
    use crate::distortion::LensDistortion;
    use crate::links::{ArmLink, Capsule};
    use crate::mark::GripperMark;

    const SIZE: usize = 48;

    fn policy() -> PinholeCamera {
        PinholeCamera::overhead(SIZE, 1.5, 0.44)
    }

    fn settings() -> PerceptionSettings {
        PerceptionSettings {
            calibration: overhead(),
            policy_camera: policy(),
            oversampling: 3,
            arm_links: vec![ArmLink { end_joints: [0, 1], radius: 0.04 }],
            mask_margin_m: 0.01,
            colour_correction: ColorCorrection::GreyWorld,
            gripper_mark: GripperMark::disc(0.03, [0, 0, 255], 1.5),
        }
    }

    /// Returns a tilted camera whose lens distorts.
    fn askew() -> CameraCalibration {
        let tilt = DMat3::from_rotation_x(0.03) * DMat3::from_rotation_z(-0.2);
        let rotation = tilt * Extrinsics::overhead(0.0).rotation;
        let position = DVec3::new(0.05, -0.12, 1.8);
        CameraCalibration {
            distortion: LensDistortion::brown_conrady([0.03, -0.02], [0.001, 0.0]),
            extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
            ..overhead()
        }
    }

    const TABLE: [u8; 3] = [112, 87, 71];
    const BLOCK: [u8; 3] = [200, 60, 40];

    /// Renders a camera's picture of a table with a block from (0.1, 0.05) to (0.22, 0.17), and of
    /// an arm of one black link.
    fn frame(camera: &CameraCalibration, link: Option<[DVec3; 2]>) -> Vec<u8> {
        let Intrinsics { width, height, .. } = camera.intrinsics;
        let eye = camera.camera_position();
        let pixel = |index: usize| {
            let middle = [(index % width) as f64 + 0.5, (index / width) as f64 + 0.5];
            let way = camera.world_direction_of_pixel(middle).unwrap();
            let capsule =
                |ends: [DVec3; 2]| Capsule { ends: ends.map(|end| end - eye), radius: 0.04 };
            let on_table = eye - way * (eye.z / way.z);
            let on_block = (0.1..0.22).contains(&on_table.x) && (0.05..0.17).contains(&on_table.y);
            match link {
                Some(ends) if capsule(ends).intersects_ray(way.normalize()) => [0; 3],
                _ if on_block => BLOCK,
                _ => TABLE,
            }
        };
        (0..width * height).flat_map(pixel).collect()
    }

    fn table() -> Vec<u8> {
        TABLE.repeat(SIZE * SIZE)
    }

    /// Returns the policy camera's picture of the table with the block.
    fn expected() -> Vec<u8> {
        let camera = CameraCalibration { intrinsics: policy().intrinsics, ..overhead() };
        frame(&camera, None)
    }

    fn differing(a: &[u8], b: &[u8]) -> usize {
        let pixels = a.chunks_exact(3).zip(b.chunks_exact(3));
        pixels.filter(|(p, q)| p != q).count()
    }

    fn without_mark(settings: PerceptionSettings) -> PerceptionSettings {
        let mark = GripperMark { outer_radius: 0.0, ..settings.gripper_mark };
        PerceptionSettings { gripper_mark: mark, ..settings }
    }

    const LINK: [DVec3; 2] = [DVec3::new(-0.2, -0.4, 0.5), DVec3::new(0.12, 0.1, 0.2)];

    /// The observation matches the policy camera's picture from every camera pose, and with an arm
    /// in view. The edges of the block go through pixels, whose median is one colour or the other.
    #[test]
    fn a_picture_from_elsewhere_becomes_the_policys_own() {
        for calibration in [overhead(), askew()] {
            let settings = without_mark(PerceptionSettings { calibration, ..settings() });
            let mut perception = Perception::new(settings, &table()).unwrap();
            let parked = [DVec3::new(0.0, -3.0, 0.0); 2];
            perception.begin_episode(&frame(&calibration, None), &parked).unwrap();
            let mut out = vec![0; 3 * SIZE * SIZE];
            let seen = frame(&calibration, Some(LINK));
            perception.observe(&seen, &LINK, DVec3::ZERO, &mut out).unwrap();
            let off = differing(&out, &expected());
            assert!(off <= 8, "{off} pixels");
            let hidden = perception.arm_mask().iter().filter(|hidden| **hidden).count();
            assert!(hidden > 500, "{hidden}");
            // an arm that nobody masks shows
            perception.observe(&seen, &parked, DVec3::ZERO, &mut out).unwrap();
            assert!(differing(&out, &expected()) > 50);
        }
    }

    /// The area behind an arm that is parked in view is filled with the empty table.
    #[test]
    fn what_a_parked_arm_hides_is_empty_table() {
        let mut perception = Perception::new(without_mark(settings()), &table()).unwrap();
        let parked = [DVec3::new(-0.3, -0.4, 0.3), DVec3::new(0.1, -0.4, 0.3)];
        let seen = frame(&overhead(), Some(parked));
        perception.begin_episode(&seen, &parked).unwrap();
        let mut out = vec![0; 3 * SIZE * SIZE];
        perception.observe(&seen, &parked, DVec3::ZERO, &mut out).unwrap();
        assert!(differing(&out, &expected()) <= 8);
    }

    /// A darker and warmer picture is corrected to the colours of the policy's table.
    #[test]
    fn other_light_is_taken_back() {
        let mut perception = Perception::new(without_mark(settings()), &table()).unwrap();
        let gains = [0.9, 0.85, 0.8].into_iter().cycle();
        let dim = frame(&overhead(), None).into_iter().zip(gains);
        let dim: Vec<u8> = dim.map(|(v, gain)| (f64::from(v) * gain).round() as u8).collect();
        perception.begin_episode(&dim, &[DVec3::new(0.0, -3.0, 0.0); 2]).unwrap();
        let mut out = vec![0; 3 * SIZE * SIZE];
        perception.observe(&dim, &LINK, DVec3::ZERO, &mut out).unwrap();
        let off = out.iter().zip(&expected()).filter(|(a, b)| a.abs_diff(**b) > 2).count();
        assert!(off <= 24, "{off}");
    }

    #[test]
    fn the_mark_is_where_the_policys_camera_would_see_the_gripper() {
        let mut perception = Perception::new(settings(), &table()).unwrap();
        let gripper = DVec3::new(-0.1, -0.2, 0.25);
        let mut out = vec![0; 3 * SIZE * SIZE];
        perception.observe(&frame(&overhead(), None), &LINK, gripper, &mut out).unwrap();
        let mut expected = table();
        settings().gripper_mark.draw(&policy(), gripper, &mut expected);
        let marked = |picture: &[u8]| -> Vec<usize> {
            let pixels = picture.chunks_exact(3).enumerate();
            pixels.filter(|(_, rgb)| rgb == &[0, 0, 255]).map(|(i, _)| i).collect()
        };
        assert!(marked(&out).len() > 5);
        assert_eq!(marked(&out), marked(&expected));
    }

    #[test]
    fn what_the_camera_does_not_see_and_nonsense_are_refused() {
        type Change = fn(&mut PerceptionSettings);
        let changes: [(Change, &str); 6] = [
            (|of| of.calibration.extrinsics = Extrinsics::overhead(0.9), "640 x 480"),
            (|of| of.calibration.extrinsics = Extrinsics::overhead(-1.0), "height of the camera"),
            (|of| of.policy_camera.extrinsics = askew().extrinsics, "policy's view"),
            (|of| of.oversampling = 4, "`oversampling` is 4"),
            (|of| of.mask_margin_m = -0.1, "`mask_margin_m` is -0.1"),
            (|of| of.calibration.distortion.radial[0] = 3.0, "distortion"),
        ];
        for (change, says) in changes {
            let mut settings = settings();
            change(&mut settings);
            let message = Perception::new(settings, &table()).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
        assert!(Perception::new(settings(), &table()[3..]).is_err());
        let mut perception = Perception::new(settings(), &table()).unwrap();
        let before = perception.clone();
        let frame = vec![90; 3 * 640 * 480];
        let mut out = vec![0; 3 * SIZE * SIZE];
        let nan = [DVec3::NAN; 2];
        assert!(perception.observe(&frame[3..], &LINK, DVec3::ZERO, &mut out).is_err());
        assert!(perception.observe(&frame, &nan, DVec3::ZERO, &mut out).is_err());
        assert!(perception.observe(&frame, &LINK, DVec3::ZERO, &mut out[3..]).is_err());
        assert!(out.iter().all(|&level| level == 0));
        assert_eq!(perception.arm_mask(), before.arm_mask());
    }
}

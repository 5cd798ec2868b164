//! From a real camera's picture to what a policy sees: rectified, cropped, without the arm, in the
//! colours that the policy knows.

use glam::DVec3;

use crate::calibration::Calibration;
use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::color::ColorCorrection;
use crate::error::{InpaintingError, check_picture, require};
use crate::inpainter::{Inpainter, InpainterSettings};
use crate::links::Link;
use crate::mark::Mark;
use crate::warp::Warp;

/// Most pixels along the side of a pixel of the policy's.
const FINEST: usize = 15;
/// How far the policy's camera may be from looking straight down.
const STRAIGHT: f64 = 1e-9;

/// What a [`Perception`] knows beforehand.
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

/// What a policy sees of a table, made of a real camera's pictures.
///
/// A picture is taken apart in four steps. It is rectified: as if the camera stood where it stands,
/// looked straight down and had the table where the policy's camera has it. The arm is painted out
/// of that ([`Inpainter`]). Each pixel of the policy's is the median, channel by channel, of the
/// pixels in it. The mark is drawn where the policy's camera would see the gripper.
#[derive(Clone, Debug, PartialEq)]
pub struct Perception {
    settings: PerceptionSettings,
    rectification: Warp,
    /// The table as the policy knows it, in the pixels of the in-painting.
    table: Vec<u8>,
    inpainter: Inpainter,
    rectified: Vec<u8>,
    painted: Vec<u8>,
}

impl Perception {
    /// A perception of the empty table that `table` `[H, W, 3]` shows as the policy knows it. Its
    /// colours are those that every picture is brought to.
    ///
    /// # Errors
    /// [`InpaintingError::Value`], [`InpaintingError::Length`]; [`InpaintingError::OutOfSight`]
    /// where the camera does not see all that the policy's camera sees.
    pub fn new(settings: PerceptionSettings, table: &[u8]) -> Result<Self, InpaintingError> {
        settings.check()?;
        let view = settings.view()?;
        check_picture("table", table, settings.policy.pixels())?;
        let table = settings.enlarged(table);
        let inpainter = Inpainter::new(settings.inpainter(view), &table)?;
        Ok(Self {
            rectification: rectification(&settings.calibration, &view)?,
            inpainter,
            rectified: vec![0; table.len()],
            painted: vec![0; table.len()],
            table,
            settings,
        })
    }

    /// Begins an episode with a picture of the table and its things, on which the arm, parked with
    /// its joints at `joints`, is in nothing's way. What it hides nevertheless is taken to be empty
    /// table.
    ///
    /// # Errors
    /// As [`Perception::look`].
    pub fn begin(&mut self, frame: &[u8], joints: &[DVec3]) -> Result<(), InpaintingError> {
        self.rectification.apply(frame, &mut self.rectified)?;
        let settings = self.inpainter.settings().clone();
        let mut empty = Inpainter::new(settings.clone(), &self.table)?;
        empty.inpaint(&self.rectified, joints, DVec3::ZERO, &mut self.painted)?;
        self.inpainter = Inpainter::new(settings, &self.painted)?;
        Ok(())
    }

    /// Writes into `out` `[H, W, 3]` what the policy sees of `frame`, the camera's picture, which
    /// was taken with the arm's joints at `joints`. The mark is drawn at `gripper` (metres, world
    /// frame), which may be a later place.
    ///
    /// # Errors
    /// As [`Inpainter::inpaint`]. After an error the perception is as before.
    pub fn look(
        &mut self,
        frame: &[u8],
        joints: &[DVec3],
        gripper: DVec3,
        out: &mut [u8],
    ) -> Result<(), InpaintingError> {
        check_picture("out", out, self.settings.policy.pixels())?;
        self.rectification.apply(frame, &mut self.rectified)?;
        self.inpainter
            .inpaint(&self.rectified, joints, gripper, &mut self.painted)?;
        self.settings.shrink(&self.painted, out);
        self.settings.mark.draw(&self.settings.policy, gripper, out);
        Ok(())
    }

    /// What it knows beforehand.
    pub fn settings(&self) -> &PerceptionSettings {
        &self.settings
    }

    /// Where the last picture's arm was, in the pixels of the in-painting `[k H, k W]`.
    pub fn mask(&self) -> &[bool] {
        self.inpainter.mask()
    }

    /// The camera whose pictures the arm is painted out of.
    pub fn view(&self) -> &PinholeCamera {
        &self.inpainter.settings().camera
    }
}

impl PerceptionSettings {
    fn check(&self) -> Result<(), InpaintingError> {
        self.calibration.check()?;
        self.policy.check()?;
        self.mark.check()?;
        let odd = self.oversampling % 2 == 1 && self.oversampling <= FINEST;
        let expected = "an odd number, 15 at most";
        require(odd, "oversampling", &self.oversampling, expected)?;
        let thick = self.growth >= 0.0 && self.growth.is_finite();
        require(thick, "growth", &self.growth, "a length in metres")?;
        let down = self.policy.extrinsics.rotation.transpose().z_axis;
        let straight = down.abs_diff_eq(DVec3::NEG_Z, STRAIGHT);
        require(
            straight,
            "policy's view",
            &down,
            "straight down, [0, 0, -1]",
        )?;
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
    fn view(&self) -> Result<PinholeCamera, InpaintingError> {
        let Extrinsics { rotation, .. } = self.policy.extrinsics;
        let (from, to) = (
            self.policy.extrinsics.position(),
            self.calibration.position(),
        );
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
            extrinsics: Extrinsics {
                rotation,
                translation: -(rotation * to),
            },
        };
        view.check()?;
        Ok(view)
    }

    fn inpainter(&self, camera: PinholeCamera) -> InpainterSettings {
        let links = self.links.iter().map(|link| Link {
            radius: link.radius + self.growth,
            ..*link
        });
        InpainterSettings {
            camera,
            links: links.collect(),
            correction: self.correction,
            // drawn last, in the policy's own pixels
            mark: Mark {
                radius: 0.0,
                hole: 0.0,
                ..self.mark
            },
        }
    }

    /// Each pixel of the policy's as a square of the in-painting's.
    fn enlarged(&self, picture: &[u8]) -> Vec<u8> {
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
    fn shrink(&self, painted: &[u8], out: &mut [u8]) {
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

/// Where the pixels of `view` are in the pictures of a camera in the same place.
fn rectification(calibration: &Calibration, view: &PinholeCamera) -> Result<Warp, InpaintingError> {
    let Intrinsics { width, height, .. } = calibration.intrinsics;
    let across = view.intrinsics.width;
    let back = view.extrinsics.rotation.transpose();
    let place = |index| calibration.pixel(back * view.ray(index / across, index % across));
    Warp::new([width, height], (0..view.pixels()).map(place))
}

#[cfg(test)]
mod tests;

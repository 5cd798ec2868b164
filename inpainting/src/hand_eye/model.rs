//! Model of a hand-eye calibration: camera and ball offset, with residuals and derivatives.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};

use crate::calibration::CameraCalibration;
use crate::camera::{Extrinsics, require_valid_coordinates};
use crate::error::{InpaintingError, require_that};

use super::equations::{NormalEquations, UNKNOWNS, Vector};

/// Returns the camera rotated by `quarters` quarter turns about its optical axis.
pub(super) fn rotated(calibration: &CameraCalibration, quarters: usize) -> CameraCalibration {
    let turn = DMat3::from_rotation_z(quarters as f64 * FRAC_PI_2);
    let Extrinsics { rotation, translation } = calibration.extrinsics;
    CameraCalibration {
        extrinsics: Extrinsics { rotation: turn * rotation, translation: turn * translation },
        ..*calibration
    }
}

/// Estimate of the unknowns of a hand-eye calibration, and its residuals.
#[derive(Clone, Debug)]
pub(super) struct HandEyeFit<'a> {
    calibration: CameraCalibration,
    settings: HandEyeSettings,
    /// Estimate of the ball's offset in the hand; the given one if it is known.
    guess: DVec3,
    sightings: &'a [BallSighting],
    /// Observed minus expected column and row of each ball (pixels).
    residuals: Vec<[f64; 2]>,
    cost: f64,
}

impl<'a> HandEyeFit<'a> {
    /// Creates the first estimate, with an unknown offset at zero and the focal lengths as given;
    /// `None` if a ball would be out of sight.
    pub fn new(
        calibration: CameraCalibration,
        settings: HandEyeSettings,
        sightings: &'a [BallSighting],
    ) -> Option<Self> {
        let guess = match settings.ball_offset {
            BallOffsetInHand::Known(offset) => offset,
            BallOffsetInHand::Unknown => DVec3::ZERO,
        };
        let settings = HandEyeSettings { estimate_focal_length: false, ..settings };
        Self::at(calibration, settings, guess, sightings)
    }

    /// Creates an estimate with its residuals; `None` if a ball would be out of sight.
    fn at(
        calibration: CameraCalibration,
        settings: HandEyeSettings,
        guess: DVec3,
        sightings: &'a [BallSighting],
    ) -> Option<Self> {
        let residual = |sighting: &BallSighting| {
            let ball = sighting.hand_position + sighting.hand_rotation * guess;
            let [column, row] =
                calibration.project_world_direction(ball - calibration.camera_position())?;
            Some([sighting.ball_pixel[0] - column, sighting.ball_pixel[1] - row])
        };
        let residuals = sightings.iter().map(residual).collect::<Option<Vec<_>>>()?;
        let cost: f64 = residuals.iter().flatten().map(|part| part * part).sum();
        let fit = Self { calibration, settings, guess, sightings, residuals, cost };
        cost.is_finite().then_some(fit)
    }

    /// Returns this estimate with the residuals of other sightings of the ball; `None` if it would
    /// be out of sight in one of them.
    pub fn with_sightings<'b>(&self, sightings: &'b [BallSighting]) -> Option<HandEyeFit<'b>> {
        HandEyeFit::at(self.calibration, self.settings, self.guess, sightings)
    }

    /// Returns the estimated calibration of the camera.
    pub fn calibration(&self) -> CameraCalibration {
        self.calibration
    }

    /// Returns the ball's offset in the hand (metres).
    pub fn ball_offset(&self) -> DVec3 {
        self.guess
    }

    /// Returns the settings of the hand-eye calibration.
    pub fn settings(&self) -> &HandEyeSettings {
        &self.settings
    }

    /// Returns the sightings of the ball that the estimate is fitted to.
    pub fn sightings(&self) -> &'a [BallSighting] {
        self.sightings
    }

    /// Returns the sum of the squared residuals (square pixels).
    pub fn sum_of_squares(&self) -> f64 {
        self.cost
    }

    /// Returns a copy of the estimate, not fitted again, in which the ball's offset is held at its
    /// value.
    pub fn with_known_offset(&self) -> Self {
        let offset = BallOffsetInHand::Known(self.guess);
        Self { settings: HandEyeSettings { ball_offset: offset, ..self.settings }, ..self.clone() }
    }

    /// Returns a copy of the estimate, not fitted again, in which the focal length is an unknown if
    /// `estimate_focal`, else held.
    pub fn with_focal_estimation(&self, estimate_focal: bool) -> Self {
        Self {
            settings: HandEyeSettings { estimate_focal_length: estimate_focal, ..self.settings },
            ..self.clone()
        }
    }

    /// Returns the index of the focal length among the unknowns: after the camera's rotation and
    /// position, and the offset if it is unknown.
    pub fn focal_length_index(&self) -> usize {
        match self.settings.ball_offset {
            BallOffsetInHand::Known(_) => 6,
            BallOffsetInHand::Unknown => 9,
        }
    }

    /// Returns the number of unknowns that are not held.
    fn free(&self) -> usize {
        self.focal_length_index() + usize::from(self.settings.estimate_focal_length)
    }

    /// Returns the degrees of freedom of the residuals: the number of equations less that of the
    /// unknowns.
    pub fn degrees_of_freedom(&self) -> f64 {
        (2 * self.residuals.len() - self.free()) as f64
    }

    /// Returns the standard deviation (pixels) of the observed ball positions, estimated from the
    /// residuals.
    pub fn noise_sd(&self) -> f64 {
        (self.cost / self.degrees_of_freedom()).sqrt()
    }

    /// Returns the normal equations of the next Gauss-Newton step of the hand-eye calibration.
    pub fn normal_equations(&self) -> NormalEquations {
        let mut equations = NormalEquations::new(self.free());
        let seen = self.sightings.iter().zip(&self.residuals);
        let rows = seen.flat_map(|(sighting, residual)| {
            self.rows(sighting, *residual).into_iter().zip(*residual)
        });
        rows.for_each(|(row, value)| equations.add_equation(&row, value));
        equations
    }

    /// Returns the derivatives of a ball's column and row with respect to the unknowns. The focal
    /// length's unknown is its logarithm.
    fn rows(&self, sighting: &BallSighting, residual: [f64; 2]) -> [Vector; 2] {
        let Extrinsics { rotation, translation } = self.calibration.extrinsics;
        let ball = sighting.hand_position + sighting.hand_rotation * self.guess;
        let seen = rotation * ball + translation;
        let gradients = self.calibration.pixel_gradients(seen);
        let centre = self.calibration.intrinsics.principal_point;
        [0, 1].map(|axis| {
            let gradient = gradients[axis];
            let in_world = rotation.transpose() * gradient;
            let [turn, position, offset] =
                [seen.cross(gradient), -in_world, sighting.hand_rotation.conjugate() * in_world];
            let parts = [turn, position, offset].map(|part| part.to_array());
            let mut row = [0.0; UNKNOWNS];
            row[..9].copy_from_slice(parts.as_flattened());
            if self.settings.estimate_focal_length {
                // the expected pixel relative to the principal point, which scales with the focal
                // length
                row[self.focal_length_index()] =
                    sighting.ball_pixel[axis] - residual[axis] - centre[axis];
            }
            row
        })
    }

    /// Returns the estimate with its unknowns changed by `step`; `None` if a ball would then be out
    /// of sight.
    pub fn after_step(&self, step: &Vector) -> Option<Self> {
        let turn = DQuat::from_scaled_axis(DVec3::from_slice(&step[..3]));
        let old = DQuat::from_mat3(&self.calibration.extrinsics.rotation);
        let rotation = DMat3::from_quat((turn * old).normalize());
        let position = self.calibration.camera_position() + DVec3::from_slice(&step[3..6]);
        let mut calibration = CameraCalibration {
            extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
            ..self.calibration
        };
        if self.settings.estimate_focal_length {
            let growth = step[self.focal_length_index()].exp();
            calibration.intrinsics.focal_lengths =
                calibration.intrinsics.focal_lengths.map(|f| growth * f);
        }
        let guess = match self.settings.ball_offset {
            BallOffsetInHand::Known(offset) => offset,
            BallOffsetInHand::Unknown => self.guess + DVec3::from_slice(&step[6..9]),
        };
        Self::at(calibration, self.settings, guess, self.sightings)
    }

    /// Returns the residual of the ball in each arm pose.
    pub fn residuals(&self) -> Vec<BallResidual> {
        let pairs = self.sightings.iter().zip(&self.residuals);
        let residual = |(sighting, [right, down]): (&BallSighting, &[f64; 2])| {
            let [column, row] = sighting.ball_pixel;
            let expected = [column - right, row - down];
            let points = [sighting.ball_pixel, expected].map(|pixel| self.on_table(pixel));
            BallResidual {
                pose_number: sighting.pose_number,
                distance_px: right.hypot(*down),
                table_distance_m: match points {
                    [Some(seen), Some(wanted)] => Some(seen.distance(wanted)),
                    _ => None,
                },
            }
        };
        pairs.map(residual).collect()
    }

    /// Returns the point at which the line of sight of a pixel meets the plane z = 0. `None` if it
    /// does not.
    fn on_table(&self, pixel: [f64; 2]) -> Option<DVec3> {
        let (eye, ray) =
            (self.calibration.camera_position(), self.calibration.world_direction_of_pixel(pixel)?);
        let part = -eye.z / ray.z;
        (part.is_finite() && part > 0.0).then(|| eye + part * ray)
    }

    /// Returns the largest residual (pixels) that counts as noise, for the ball of a pose: what the
    /// arm's accuracy and the ball's outline explain.
    fn limit(&self, sighting: &BallSighting) -> f64 {
        let ball = sighting.hand_position + sighting.hand_rotation * self.guess;
        let depth = self.calibration.to_pinhole().world_to_camera(ball).z;
        let of_arm =
            self.calibration.intrinsics.focal_lengths[0] * self.settings.arm_position_sd / depth;
        LIMIT_SIGMAS * of_arm.hypot(OUTLINE_SD)
    }

    /// Returns the residual of each arm pose, and the largest one (pixels) that counts as noise
    /// there.
    pub fn residuals_with_noise_limits(&self) -> impl Iterator<Item = (BallResidual, f64)> {
        let limits = self.sightings.iter().map(|sighting| self.limit(sighting));
        self.residuals().into_iter().zip(limits)
    }

    /// Returns `true` if all residuals can be noise: none is beyond its limit.
    pub fn is_within_noise_limits(&self) -> bool {
        self.residuals_with_noise_limits().all(|(residual, limit)| residual.distance_px <= limit)
    }
}

/// Largest residual of a hand-eye calibration that counts as noise, in standard deviations.
pub(super) const LIMIT_SIGMAS: f64 = 4.0;
/// Standard deviation (pixels) of the middle of a ball that is found by its outline.
pub(super) const OUTLINE_SD: f64 = 0.2;

/// Settings of a hand-eye calibration, see
/// [`HandEyeCalibration::solve`](super::HandEyeCalibration::solve).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeSettings {
    /// Position of the ball in the hand's frame.
    pub ball_offset: BallOffsetInHand,
    /// Standard deviation (metres) of the ball's position by the arm's joints. Residuals of four of
    /// these, projected into the picture, count as noise.
    pub arm_position_sd: f64,
    /// `true` to estimate the focal lengths, too. Their ratio is kept.
    pub estimate_focal_length: bool,
}

impl HandEyeSettings {
    /// Rejects an offset or an accuracy out of range, before an arm moves in vain.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        let accuracy = self.arm_position_sd;
        let expected = "at most 0.1 metres and at least 1e-6 (`--arm-accuracy` is in millimetres)";
        require_that((1e-6..=0.1).contains(&accuracy), "accuracy of the arm", &accuracy, expected)?;
        match self.ball_offset {
            BallOffsetInHand::Known(offset) => {
                require_valid_coordinates("offset of the ball", offset)
            }
            BallOffsetInHand::Unknown => Ok(()),
        }
    }
}

impl From<BallOffsetInHand> for HandEyeSettings {
    /// Returns the settings for an arm that is accurate to 2.5 mm and for given focal lengths.
    fn from(ball_offset: BallOffsetInHand) -> Self {
        Self { ball_offset, arm_position_sd: 0.0025, estimate_focal_length: false }
    }
}

/// Observation of the ball in one pose of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallSighting {
    /// Number of the arm pose, for messages.
    pub pose_number: usize,
    /// Position of the hand according to the arm's joints (metres, world).
    pub hand_position: DVec3,
    /// Rotation from the hand's axes to the world's.
    pub hand_rotation: DQuat,
    /// Column and row of the ball (pixels; the middle of the first one is at 0.5).
    pub ball_pixel: [f64; 2],
}

/// Position of the ball in the hand's frame: known (metres), or unknown and to be solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallOffsetInHand {
    /// Known offset of the ball in the hand's frame (metres).
    Known(DVec3),
    /// Offset that is solved for, which requires poses in which the hand turns about two axes.
    Unknown,
}

/// Distance of the ball in one arm pose from its expected position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallResidual {
    /// Number of the arm pose.
    pub pose_number: usize,
    /// Distance between seen and expected ball in the picture (pixels).
    pub distance_px: f64,
    /// Distance on the table, the plane z = 0, between the two lines of sight (metres); `None` if
    /// one of them does not meet it.
    pub table_distance_m: Option<f64>,
}

//! Model of a hand-eye calibration: camera and ball offset, with residuals and derivatives.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};

use crate::calibration::Calibration;
use crate::camera::Extrinsics;
use crate::error::InpaintingError;

use super::equations::{Equations, UNKNOWNS, Vector};

/// Returns the camera rotated by `quarters` quarter turns about its optical axis.
pub(super) fn rotated(calibration: &Calibration, quarters: usize) -> Calibration {
    let turn = DMat3::from_rotation_z(quarters as f64 * FRAC_PI_2);
    let Extrinsics { rotation, translation } = calibration.extrinsics;
    Calibration {
        extrinsics: Extrinsics { rotation: turn * rotation, translation: turn * translation },
        ..*calibration
    }
}

/// Estimate of the unknowns, and its residuals.
#[derive(Clone, Debug)]
pub(super) struct Fit<'a> {
    calibration: Calibration,
    offset: Offset,
    /// `true` if the focal length is solved for.
    free_focal: bool,
    /// Estimate of the offset; the given one if it is known.
    guess: DVec3,
    sightings: &'a [BallSighting],
    /// Observed minus expected column and row (pixels).
    residuals: Vec<[f64; 2]>,
    cost: f64,
}

impl<'a> Fit<'a> {
    /// Starts an estimate, an unknown offset at zero. `None` if a ball would be out of sight.
    pub fn new(
        calibration: Calibration,
        offset: Offset,
        sightings: &'a [BallSighting],
    ) -> Option<Self> {
        let guess = match offset {
            Offset::Known(offset) => offset,
            Offset::Unknown => DVec3::ZERO,
        };
        Self::at(calibration, offset, guess, false, sightings)
    }

    /// Computes the residuals of an estimate. `None` if a ball would be out of sight.
    fn at(
        calibration: Calibration,
        offset: Offset,
        guess: DVec3,
        free_focal: bool,
        sightings: &'a [BallSighting],
    ) -> Option<Self> {
        let residual = |sighting: &BallSighting| {
            let ball = sighting.position + sighting.rotation * guess;
            let [column, row] = calibration.pixel(ball - calibration.position())?;
            Some([sighting.pixel[0] - column, sighting.pixel[1] - row])
        };
        let residuals = sightings.iter().map(residual).collect::<Option<Vec<_>>>()?;
        let cost: f64 = residuals.iter().flatten().map(|part| part * part).sum();
        cost.is_finite().then_some(Self {
            calibration,
            offset,
            free_focal,
            guess,
            sightings,
            residuals,
            cost,
        })
    }

    /// Returns the camera that was fitted.
    pub fn calibration(&self) -> Calibration {
        self.calibration
    }

    /// Returns the ball's offset in the hand (metres).
    pub fn offset(&self) -> DVec3 {
        self.guess
    }

    /// Returns the sum of the squared residuals (square pixels).
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Returns a copy with the current offset held.
    pub fn with_known_offset(&self) -> Self {
        Self { offset: Offset::Known(self.guess), ..self.clone() }
    }

    /// Returns a copy with the focal length among the unknowns.
    pub fn with_free_focal(&self) -> Self {
        Self { free_focal: true, ..self.clone() }
    }

    /// Returns the index of the focal length among the unknowns: after the camera's rotation and
    /// position, and the offset if it is unknown.
    pub fn focal_index(&self) -> usize {
        match self.offset {
            Offset::Known(_) => 6,
            Offset::Unknown => 9,
        }
    }

    /// Returns the number of unknowns.
    fn free(&self) -> usize {
        self.focal_index() + usize::from(self.free_focal)
    }

    /// Returns the standard deviation (pixels) of the observations, estimated from the residuals.
    pub fn noise(&self) -> f64 {
        let degrees_of_freedom = 2 * self.residuals.len() - self.free();
        (self.cost / degrees_of_freedom as f64).sqrt()
    }

    /// Returns the normal equations of a Gauss-Newton step.
    pub fn equations(&self) -> Equations {
        let mut equations = Equations::new(self.free());
        let seen = self.sightings.iter().zip(&self.residuals);
        let rows = seen.flat_map(|(sighting, residual)| {
            self.rows(sighting, *residual).into_iter().zip(*residual)
        });
        rows.for_each(|(row, value)| equations.add(&row, value));
        equations
    }

    /// Returns the derivatives of the column and of the row by the unknowns. The focal length's
    /// unknown is its logarithm.
    fn rows(&self, sighting: &BallSighting, residual: [f64; 2]) -> [Vector; 2] {
        let Extrinsics { rotation, translation } = self.calibration.extrinsics;
        let ball = sighting.position + sighting.rotation * self.guess;
        let seen = rotation * ball + translation;
        let gradients = self.calibration.pixel_gradients(seen);
        let centre = self.calibration.intrinsics.centre;
        [0, 1].map(|axis| {
            let gradient = gradients[axis];
            let in_world = rotation.transpose() * gradient;
            let [turn, position, offset] =
                [seen.cross(gradient), -in_world, sighting.rotation.conjugate() * in_world];
            let parts = [turn, position, offset].map(|part| part.to_array());
            let mut row = [0.0; UNKNOWNS];
            row[..9].copy_from_slice(parts.as_flattened());
            if self.free_focal {
                // the expected pixel relative to the principal point, which scales with the focal
                // length
                row[self.focal_index()] = sighting.pixel[axis] - residual[axis] - centre[axis];
            }
            row
        })
    }

    /// Returns the estimate after a step. `None` if a ball would then be out of sight.
    pub fn after(&self, step: &Vector) -> Option<Self> {
        let turn = DQuat::from_scaled_axis(DVec3::from_slice(&step[..3]));
        let old = DQuat::from_mat3(&self.calibration.extrinsics.rotation);
        let rotation = DMat3::from_quat((turn * old).normalize());
        let position = self.calibration.position() + DVec3::from_slice(&step[3..6]);
        let mut calibration = Calibration {
            extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
            ..self.calibration
        };
        if self.free_focal {
            let growth = step[self.focal_index()].exp();
            calibration.intrinsics.focal = calibration.intrinsics.focal.map(|f| growth * f);
        }
        let guess = match self.offset {
            Offset::Known(offset) => offset,
            Offset::Unknown => self.guess + DVec3::from_slice(&step[6..9]),
        };
        Self::at(calibration, self.offset, guess, self.free_focal, self.sightings)
    }

    /// Returns the residuals of all poses.
    pub fn residuals(&self) -> Vec<Residual> {
        let pairs = self.sightings.iter().zip(&self.residuals);
        let residual = |(sighting, [right, down]): (&BallSighting, &[f64; 2])| {
            let [column, row] = sighting.pixel;
            let expected = [column - right, row - down];
            let points = [sighting.pixel, expected].map(|pixel| self.on_table(pixel));
            Residual {
                pose: sighting.pose,
                pixels: right.hypot(*down),
                on_table: match points {
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
        let (eye, ray) = (self.calibration.position(), self.calibration.direction(pixel)?);
        let part = -eye.z / ray.z;
        (part.is_finite() && part > 0.0).then(|| eye + part * ray)
    }

    /// Rejects residuals of more than [`MAX_RESIDUAL`].
    pub fn check_misfit(&self) -> Result<(), InpaintingError> {
        let residuals = self.residuals();
        let worst = residuals.iter().max_by(|a, b| a.pixels.total_cmp(&b.pixels));
        match worst {
            Some(worst) if worst.pixels > MAX_RESIDUAL => Err(InpaintingError::Misfit {
                pose: worst.pose,
                pixels: worst.pixels,
                limit: MAX_RESIDUAL,
            }),
            _ => Ok(()),
        }
    }
}

/// Largest residual of a pose (pixels) that counts as noise: 10 mm on a table 1.5 m away.
pub const MAX_RESIDUAL: f64 = 4.0;

/// Observation of the ball in one pose of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallSighting {
    /// Number of the pose, for messages.
    pub pose: usize,
    /// Position of the hand by its joints (metres, world).
    pub position: DVec3,
    /// Rotation from the hand's axes to the world's.
    pub rotation: DQuat,
    /// Column and row of the ball (pixels; the middle of the first one is at 0.5).
    pub pixel: [f64; 2],
}

/// Position of the ball in the hand's frame (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Offset {
    /// Given offset.
    Known(DVec3),
    /// Offset that is solved for, which requires poses in which the hand turns about two axes.
    Unknown,
}

/// Distance of the ball of a pose from its expected position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Index of the hand's pose.
    pub pose: usize,
    /// Distance between seen and expected ball in the picture (pixels).
    pub pixels: f64,
    /// Distance on the table, the plane z = 0, between the two lines of sight (metres); `None` if
    /// one of them does not meet it.
    pub on_table: Option<f64>,
}

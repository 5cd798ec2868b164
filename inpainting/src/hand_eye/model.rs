//! A camera and a ball's offset, with where they let the balls be seen.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DQuat, DVec3};

use crate::calibration::Calibration;
use crate::camera::Extrinsics;
use crate::error::InpaintingError;

use super::equations::{Equations, UNKNOWNS, Vector};

/// A camera that somebody turned by quarters about its optical axis.
pub(super) fn turned(calibration: &Calibration, quarters: usize) -> Calibration {
    let turn = DMat3::from_rotation_z(quarters as f64 * FRAC_PI_2);
    let Extrinsics { rotation, translation } = calibration.extrinsics;
    Calibration {
        extrinsics: Extrinsics { rotation: turn * rotation, translation: turn * translation },
        ..*calibration
    }
}

/// A guess, and its residuals.
#[derive(Clone, Debug)]
pub(super) struct Fit<'a> {
    calibration: Calibration,
    offset: Offset,
    /// `true` if the focal length is solved for.
    free_focal: bool,
    /// The offset, where it is unknown.
    guess: DVec3,
    sightings: &'a [Sighting],
    /// Seen less expected (pixels).
    residuals: Vec<[f64; 2]>,
    cost: f64,
}

impl<'a> Fit<'a> {
    /// None where a ball would be out of sight.
    pub fn new(
        calibration: Calibration,
        offset: Offset,
        sightings: &'a [Sighting],
    ) -> Option<Self> {
        let guess = match offset {
            Offset::Known(offset) => offset,
            Offset::Unknown => DVec3::ZERO,
        };
        Self::at(calibration, offset, (guess, false), sightings)
    }

    fn at(
        calibration: Calibration,
        offset: Offset,
        (guess, free_focal): (DVec3, bool),
        sightings: &'a [Sighting],
    ) -> Option<Self> {
        let residual = |sighting: &Sighting| {
            let ball = sighting.position + sighting.rotation * guess;
            let [column, row] = calibration.pixel(ball - calibration.position())?;
            Some([sighting.pixel[0] - column, sighting.pixel[1] - row])
        };
        let residuals: Option<Vec<_>> = sightings.iter().map(residual).collect();
        let residuals = residuals?;
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

    /// The camera.
    pub fn calibration(&self) -> Calibration {
        self.calibration
    }

    /// The ball's place in the hand (metres).
    pub fn offset(&self) -> DVec3 {
        self.guess
    }

    /// Sum of the squared residuals.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Copy of the guess whose offset is given.
    pub fn with_known_offset(&self) -> Self {
        Self { offset: Offset::Known(self.guess), ..self.clone() }
    }

    /// Copy of the guess whose focal length is solved for.
    pub fn with_free_focal(&self) -> Self {
        Self { free_focal: true, ..self.clone() }
    }

    /// Index of the focal length among the unknowns, after the camera's turn and place and the
    /// offset.
    pub fn focal_index(&self) -> usize {
        match self.offset {
            Offset::Known(_) => 6,
            Offset::Unknown => 9,
        }
    }

    fn free(&self) -> usize {
        self.focal_index() + usize::from(self.free_focal)
    }

    /// Standard deviation (pixels) that the residuals speak for.
    pub fn noise(&self) -> f64 {
        let surplus = 2 * self.residuals.len() - self.free();
        (self.cost / surplus as f64).sqrt()
    }

    /// The normal equations of the step that would bring the residuals to zero.
    pub fn equations(&self) -> Equations {
        let mut equations = Equations::new(self.free());
        let seen = self.sightings.iter().zip(&self.residuals);
        let rows = seen.flat_map(|(sighting, residual)| {
            self.rows(sighting, *residual).into_iter().zip(*residual)
        });
        rows.for_each(|(row, value)| equations.add(&row, value));
        equations
    }

    /// Derivatives of the column and of the row by the unknowns; by the logarithm of the focal
    /// length.
    fn rows(&self, sighting: &Sighting, residual: [f64; 2]) -> [Vector; 2] {
        let Extrinsics { rotation, translation } = self.calibration.extrinsics;
        let ball = sighting.position + sighting.rotation * self.guess;
        let seen = rotation * ball + translation;
        let slopes = self.calibration.slopes(seen);
        let centre = self.calibration.intrinsics.centre;
        [0, 1].map(|axis| {
            let slope = slopes[axis];
            let in_world = rotation.transpose() * slope;
            let [turn, place, offset] =
                [seen.cross(slope), -in_world, sighting.rotation.conjugate() * in_world];
            let parts = [turn, place, offset].map(|part| part.to_array());
            let mut row = [0.0; UNKNOWNS];
            row[..9].copy_from_slice(parts.as_flattened());
            if self.free_focal {
                row[self.focal_index()] = sighting.pixel[axis] - residual[axis] - centre[axis];
            }
            row
        })
    }

    /// The guess after a step; none where a ball would then be out of sight.
    pub fn moved(&self, step: &Vector) -> Option<Self> {
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
        Self::at(calibration, self.offset, (guess, self.free_focal), self.sightings)
    }

    /// What is left of every pose.
    pub fn residuals(&self) -> Vec<Residual> {
        let pairs = self.sightings.iter().zip(&self.residuals);
        let residual = |(sighting, [right, down]): (&Sighting, &[f64; 2])| {
            let [column, row] = sighting.pixel;
            let expected = [column - right, row - down];
            let places = [sighting.pixel, expected].map(|pixel| self.on_table(pixel));
            Residual {
                pose: sighting.pose,
                pixels: right.hypot(*down),
                on_table: match places {
                    [Some(seen), Some(expected)] => Some(seen.distance(expected)),
                    _ => None,
                },
            }
        };
        pairs.map(residual).collect()
    }

    /// Where the line of sight of a pixel meets the plane z = 0.
    fn on_table(&self, pixel: [f64; 2]) -> Option<DVec3> {
        let (eye, way) = (self.calibration.position(), self.calibration.direction(pixel)?);
        let part = -eye.z / way.z;
        (part.is_finite() && part > 0.0).then(|| eye + part * way)
    }

    /// Refuses residuals that are no noise.
    pub fn check_misfit(&self) -> Result<(), InpaintingError> {
        let residuals = self.residuals();
        let worst = residuals.iter().max_by(|a, b| a.pixels.total_cmp(&b.pixels));
        match worst {
            Some(worst) if worst.pixels > LARGEST_RESIDUAL => Err(InpaintingError::Misfit {
                pose: worst.pose,
                pixels: worst.pixels,
                limit: LARGEST_RESIDUAL,
            }),
            _ => Ok(()),
        }
    }
}

/// Largest residual of a pose (pixels) that is taken for noise: 10 mm on a table 1.5 m away.
pub const LARGEST_RESIDUAL: f64 = 4.0;

/// A ball that a hand carries, as it was seen once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Number of the pose, for messages.
    pub pose: usize,
    /// Where the hand was by its joints (metres, world).
    pub position: DVec3,
    /// How it was turned: from its axes to the world's.
    pub rotation: DQuat,
    /// Column and row of the ball (pixels; the middle of the first one is at one half).
    pub pixel: [f64; 2],
}

/// Where the ball is in the frame of the hand (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Offset {
    /// It was measured.
    Known(DVec3),
    /// It is solved for, which takes a hand that turns about two axes.
    Unknown,
}

/// How far the ball of a pose is from where it is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Number of the pose.
    pub pose: usize,
    /// In the picture (pixels).
    pub pixels: f64,
    /// On the table, the plane z = 0, along the two lines of sight (metres); none where one of them
    /// does not meet it.
    pub on_table: Option<f64>,
}

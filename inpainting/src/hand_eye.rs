//! Hand-eye calibration: the pose of a camera from pictures of a ball that the arm carries.

mod equations;
mod model;

use glam::DVec3;

use crate::calibration::Calibration;
use crate::camera::{NEAR, is_near};
use crate::error::{InpaintingError, require};

use equations::UNKNOWNS;
use model::{Fit, rotated};

pub use model::{BallSighting, MAX_RESIDUAL, Offset, Residual};

/// Minimum number of poses of a hand-eye calibration.
pub const MIN_POSES: usize = 10;
/// Maximum standard deviations that one pixel of noise may cause: of positions (metres) and of
/// angles (radians).
const MAX_DILUTION: [f64; 2] = [0.1, 5.0 * std::f64::consts::PI / 180.0];
/// Maximum number of steps of the Levenberg-Marquardt method.
const STEPS: usize = 200;
/// Damping of the Levenberg-Marquardt method: first, largest, and factor between successive ones.
const DAMPING: [f64; 3] = [1e-3, 1e12, 10.0];
/// Deviation from which a focal length is rejected: in standard deviations, and relative to the
/// given one. Both must be exceeded, because small errors of the distortion cause smaller ones.
const WRONG_FOCAL: [f64; 2] = [3.5, 0.01];
/// Relative decrease of the sum of squares below which a step is the last one.
const CONVERGED: f64 = 1e-12;

/// Standard deviations of a hand-eye calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Standard deviation of the camera's position (metres, world).
    pub position: DVec3,
    /// Standard deviation of the camera's angles about its own axes, right, down and forwards
    /// (radians).
    pub angle: DVec3,
    /// Standard deviation of the ball's offset in the hand (metres); zero if it was given.
    pub offset: DVec3,
}

/// Estimate of the focal length from the poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focal {
    /// Ratio of the estimated focal length to the given one.
    pub ratio: f64,
    /// Standard deviation of the ratio of focal lengths.
    pub sigma: f64,
}

/// Result of a hand-eye calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEye {
    /// Calibrated camera, with the given distortion and intrinsics.
    pub calibration: Calibration,
    /// Position of the ball in the hand's frame (metres).
    pub offset: DVec3,
    /// Residuals of all poses, in the order given.
    pub residuals: Vec<Residual>,
    /// Uncertainty estimated from the residuals, for the given focal lengths.
    pub uncertainty: Uncertainty,
    /// Check of the focal lengths; `None` if the poses do not determine them.
    pub focal: Option<Focal>,
    /// Uncertainty that one pixel of noise would cause, which shows how well the poses are spread.
    pub dilution: Uncertainty,
}

impl HandEye {
    /// Solves for the pose of the camera, and for the ball's offset if it is unknown.
    ///
    /// Minimises the squared distances in the picture by the Levenberg-Marquardt method (Moré 1978,
    /// "The Levenberg-Marquardt algorithm"), from `start` and from `start` rotated by quarter turns
    /// about the optical axis. Distortion and intrinsics are those of `start`.
    ///
    /// # Errors
    /// [`InpaintingError::TooFewPoses`], [`InpaintingError::Value`] for numbers out of range,
    /// [`InpaintingError::Unseen`] if `start` does not see a hand, [`InpaintingError::Misfit`] for
    /// a residual of more than [`MAX_RESIDUAL`], [`InpaintingError::Undetermined`] for poses that
    /// do not determine the camera's pose, and [`InpaintingError::WrongFocal`] for a focal length
    /// that the poses contradict.
    pub fn solve(
        start: &Calibration,
        offset: Offset,
        sightings: &[BallSighting],
    ) -> Result<Self, InpaintingError> {
        check(start, offset, sightings)?;
        // a start that is wrong by a quarter turn or more could end in a local minimum
        let starts = (0..4).map(|quarter| Fit::new(rotated(start, quarter), offset, sightings));
        let best = starts
            .flatten()
            .map(minimised)
            .min_by(|a, b| a.cost().total_cmp(&b.cost()))
            .ok_or_else(|| unseen(start, offset, sightings))?;
        best.check_misfit()?;
        let dilution = best
            .equations()
            .variances()
            .map(|variances| dilution_of(&variances))
            .filter(is_tolerable)
            .ok_or_else(|| undetermined(&best))?;
        let noise = best.noise();
        let focal = focal(&best);
        focal.map_or(Ok(()), |focal| check_focal(focal, start))?;
        Ok(Self {
            focal,
            calibration: best.calibration(),
            offset: best.offset(),
            residuals: best.residuals(),
            uncertainty: Uncertainty {
                position: noise * dilution.position,
                angle: noise * dilution.angle,
                offset: noise * dilution.offset,
            },
            dilution,
        })
    }

    /// Returns the root mean square of the residuals in the picture (pixels).
    pub fn rms(&self) -> f64 {
        let all = self.residuals.iter().map(|of| of.pixels);
        root_mean_square(all).unwrap_or_default()
    }

    /// Returns the root mean square of the residuals on the table (metres), over the poses whose
    /// lines of sight meet it. `None` if there are none.
    pub fn rms_on_table(&self) -> Option<f64> {
        root_mean_square(self.residuals.iter().filter_map(|of| of.on_table))
    }

    /// Returns the largest residual. `None` without poses.
    pub fn worst(&self) -> Option<&Residual> {
        let residuals = self.residuals.iter();
        residuals.max_by(|a, b| a.pixels.total_cmp(&b.pixels))
    }
}

/// Returns the root mean square of `values`. `None` if there are none.
fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

/// Rejects an invalid start, too few poses, and numbers out of range.
fn check(
    start: &Calibration,
    offset: Offset,
    sightings: &[BallSighting],
) -> Result<(), InpaintingError> {
    start.check()?;
    if sightings.len() < MIN_POSES {
        return Err(InpaintingError::TooFewPoses { got: sightings.len(), needed: MIN_POSES });
    }
    if let Offset::Known(offset) = offset {
        require(is_near(offset), "offset of the ball", &offset, NEAR)?;
    }
    for sighting in sightings {
        let BallSighting { pose, position, rotation, pixel } = sighting;
        let value = format!("{position} in pose {pose}");
        require(is_near(*position), "position of the hand", &value, NEAR)?;
        let turn = format!("{rotation} in pose {pose}");
        let unit = (rotation.length() - 1.0).abs() < 1e-6;
        require(unit, "rotation of the hand", &turn, "a unit quaternion")?;
        let seen_pixel = format!("{pixel:?} in pose {pose}");
        let finite = is_near(DVec3::new(pixel[0], pixel[1], 0.0));
        let expected = "a column and a row of the picture";
        require(finite, "pixel of the ball", &seen_pixel, expected)?;
    }
    Ok(())
}

/// Minimises the cost by the Levenberg-Marquardt method.
fn minimised(mut fit: Fit<'_>) -> Fit<'_> {
    let [mut damping, largest, factor] = DAMPING;
    for _ in 0..STEPS {
        let equations = fit.equations();
        // a larger damping shortens the step, until it no longer increases the cost
        let step = loop {
            let better = equations.solve(damping).and_then(|step| fit.after(&step));
            match better.filter(|better| better.cost() <= fit.cost()) {
                Some(better) => break Some(better),
                None if damping >= largest => break None,
                None => damping *= factor,
            }
        };
        let Some(better) = step else {
            break;
        };
        let converged = fit.cost() - better.cost() <= CONVERGED * fit.cost();
        fit = better;
        damping /= factor;
        if converged {
            break;
        }
    }
    fit
}

/// Estimates the focal length, by solving again with it among the unknowns. `None` if the poses do
/// not determine it.
fn focal(best: &Fit<'_>) -> Option<Focal> {
    let fit = minimised(best.with_free_focal());
    let variance = fit.equations().variances()?[fit.focal_index()];
    let focal = |fitted: &Fit<'_>| fitted.calibration().intrinsics.focal[0];
    let ratio = focal(&fit) / focal(best);
    // the unknown is the logarithm of the focal length
    let sigma = ratio * fit.noise() * variance.sqrt();
    Some(Focal { ratio, sigma })
}

/// Rejects given focal lengths that the estimate contradicts.
fn check_focal(focal: Focal, start: &Calibration) -> Result<(), InpaintingError> {
    let [sigmas, part] = WRONG_FOCAL;
    let off = (focal.ratio - 1.0).abs();
    if off <= part || off <= sigmas * focal.sigma {
        return Ok(());
    }
    let given = start.intrinsics.focal;
    Err(InpaintingError::WrongFocal {
        given,
        fitted: given.map(|given| focal.ratio * given),
        sigma: focal.sigma * given[0],
    })
}

/// Splits variances into the standard deviations of angle, position and offset.
fn dilution_of(variances: &[f64; UNKNOWNS]) -> Uncertainty {
    let of = |first: usize| DVec3::from_slice(&variances[first..]).map(f64::sqrt);
    Uncertainty { angle: of(0), position: of(3), offset: of(6) }
}

/// Returns `true` if a dilution is within [`MAX_DILUTION`].
fn is_tolerable(dilution: &Uncertainty) -> bool {
    let [distance, angle] = MAX_DILUTION;
    let lengths = [dilution.position.length(), dilution.offset.length()];
    lengths.iter().all(|length| *length <= distance) && dilution.angle.length() <= angle
}

/// Returns the error of poses that do not determine the camera's pose, with advice.
fn undetermined(fit: &Fit<'_>) -> InpaintingError {
    // if a known offset would suffice, the hand turns too little
    let known = fit.with_known_offset().equations().variances();
    let would_suffice = known.is_some_and(|variances| is_tolerable(&dilution_of(&variances)));
    InpaintingError::Undetermined {
        advice: if would_suffice {
            "the hand turns too little to separate the ball's offset from the camera's position: \
                 turn it about two axes, by 10 degrees and more, or measure the offset and give it"
        } else {
            "the positions of the ball are nearly one line or one point: spread them over the \
                 table and over heights"
        },
    }
}

/// Returns the error of a start that does not see a hand, with the number of the first such pose.
fn unseen(start: &Calibration, offset: Offset, sightings: &[BallSighting]) -> InpaintingError {
    let is_unseen = |sighting: &&BallSighting| {
        Fit::new(*start, offset, std::slice::from_ref(*sighting)).is_none()
    };
    let pose = sightings.iter().find(is_unseen).map(|sighting| sighting.pose);
    InpaintingError::Unseen { pose: pose.unwrap_or_default() }
}

#[cfg(test)]
mod tests;

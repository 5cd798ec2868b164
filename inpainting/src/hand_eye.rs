//! Hand-eye calibration: the pose of a camera from pictures of a ball that the arm carries.

mod equations;
mod model;

use glam::DVec3;

use crate::calibration::CameraCalibration;
use crate::camera::{VALID_COORDINATES, has_valid_coordinates};
use crate::error::{InpaintingError, require_that};

use model::{HandEyeFit, LIMIT_SIGMAS, OUTLINE_SD, rotated};

pub use model::{BallOffsetInHand, BallResidual, BallSighting, HandEyeSettings};

/// Minimum number of arm poses of a hand-eye calibration.
pub const MIN_CALIBRATION_POSES: usize = 10;
/// Maximum standard deviations of positions (metres) and angles (radians) that one pixel of noise
/// may cause in a hand-eye calibration.
const MAX_DILUTION: [f64; 2] = [0.1, 5.0 * std::f64::consts::PI / 180.0];
/// Maximum number of steps of the Levenberg-Marquardt method.
const STEPS: usize = 200;
/// Damping of the Levenberg-Marquardt method: first and largest value, and factor between
/// successive ones.
const DAMPING: [f64; 3] = [1e-3, 1e12, 10.0];
/// Deviation of the estimated focal length from which the given one is rejected: in standard
/// deviations, and relative to the given one. Both must be exceeded, because small errors of the
/// distortion cause smaller ones.
const WRONG_FOCAL: [f64; 2] = [3.5, 0.01];
/// Significance level of the test for an outlier: the probability, over all arm poses, that noise
/// alone makes the others fit so much better without one pose.
const OUTLIER: f64 = 1e-4;
/// Relative decrease of the sum of squares below which a step of the Levenberg-Marquardt method is
/// the last one.
const CONVERGED: f64 = 1e-12;

/// Standard deviations of the results of a hand-eye calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeUncertainty {
    /// Standard deviation of the camera's position (metres, world).
    pub position_sd: DVec3,
    /// Standard deviation of the camera's angles about its own axes, right, down and forwards
    /// (radians).
    pub angle_sd: DVec3,
    /// Standard deviation of the ball's offset in the hand (metres); zero if it was given.
    pub ball_offset_sd: DVec3,
}

/// Estimate of the camera's focal length from the arm poses of a hand-eye calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FocalLengthEstimate {
    /// Ratio of the estimated focal length to the given one.
    pub ratio_to_given: f64,
    /// Standard deviation of the ratio of focal lengths.
    pub ratio_sd: f64,
}

/// Result of a hand-eye calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeCalibration {
    /// Calibrated camera, with the given distortion, and with the given focal lengths unless these
    /// are estimated.
    pub calibration: CameraCalibration,
    /// Position of the ball in the hand's frame (metres).
    pub ball_offset: DVec3,
    /// Residuals of the arm poses, in the order given.
    pub residuals: Vec<BallResidual>,
    /// Residuals of the arm poses that were left out because the others contradict them, the worst
    /// first: distances from where the others predict the ball.
    pub outliers: Vec<BallResidual>,
    /// Uncertainty of the results, estimated from the residuals, for the given focal lengths unless
    /// these are estimated.
    pub uncertainty: HandEyeUncertainty,
    /// Focal lengths estimated from the arm poses; `None` if the poses do not determine them.
    pub focal_length: Option<FocalLengthEstimate>,
    /// Uncertainty that one pixel of noise would cause, which shows how well the arm poses are
    /// spread.
    pub uncertainty_per_pixel: HandEyeUncertainty,
}

impl HandEyeCalibration {
    /// Estimates the camera's pose, and the ball's offset in the hand if unknown, from `sightings`.
    ///
    /// Minimises the squared distances in the picture by the Levenberg-Marquardt method (Moré 1978,
    /// "The Levenberg-Marquardt algorithm"), from `start` and from `start` rotated by quarter turns
    /// about the optical axis. Distortion and intrinsics are those of `start`; the focal lengths
    /// may be estimated. While more than [`MIN_CALIBRATION_POSES`] are left, a pose that the others
    /// contradict is left out.
    ///
    /// # Errors
    /// [`InpaintingError::TooFewPoses`], [`InpaintingError::InvalidValue`] for numbers out of
    /// range, [`InpaintingError::HandUnseenFromStart`] if `start` does not see a hand,
    /// [`InpaintingError::OutlierPose`] for a pose beyond the noise of
    /// [`HandEyeSettings::arm_position_sd`] and [`InpaintingError::InconsistentPoses`] for several
    /// ones, [`InpaintingError::CameraPoseUndetermined`] for poses that do not determine the
    /// camera's pose, and [`InpaintingError::WrongFocalLength`] for given focal lengths that the
    /// poses contradict.
    pub fn solve(
        start: &CameraCalibration,
        settings: impl Into<HandEyeSettings>,
        sightings: &[BallSighting],
    ) -> Result<Self, InpaintingError> {
        let settings = settings.into();
        check(start, &settings, sightings)?;
        let mut kept = sightings.to_vec();
        let mut outliers = Vec::new();
        loop {
            let best = best(start, settings, &kept)?;
            match outlier(&best) {
                None => return Self::of(&best, start, &outliers),
                Some(worst) if kept.len() > MIN_CALIBRATION_POSES => {
                    outliers.push(kept.remove(worst.index))
                }
                Some(worst) => return Err(misfit(&best, start, &worst)),
            }
        }
    }

    /// Returns the calibration of a fit without outliers, unless the arm poses do not determine it.
    fn of(
        best: &HandEyeFit<'_>,
        start: &CameraCalibration,
        outliers: &[BallSighting],
    ) -> Result<Self, InpaintingError> {
        let dilution = dilution_of(best).filter(is_tolerable).ok_or_else(|| undetermined(best))?;
        let noise = best.noise_sd();
        let focal = focal(best, start);
        if !best.settings().estimate_focal_length {
            focal.map_or(Ok(()), |focal| check_focal(focal, start))?;
        }
        let unseen = |pose_number| BallResidual {
            pose_number,
            distance_px: f64::INFINITY,
            table_distance_m: None,
        };
        let left_out = outliers.iter().map(|outlier| {
            let fit = best.with_sightings(std::slice::from_ref(outlier));
            fit.map_or_else(|| unseen(outlier.pose_number), |fit| fit.residuals()[0])
        });
        Ok(Self {
            focal_length: focal,
            calibration: best.calibration(),
            ball_offset: best.ball_offset(),
            residuals: best.residuals(),
            outliers: left_out.collect(),
            uncertainty: HandEyeUncertainty {
                position_sd: noise * dilution.position_sd,
                angle_sd: noise * dilution.angle_sd,
                ball_offset_sd: noise * dilution.ball_offset_sd,
            },
            uncertainty_per_pixel: dilution,
        })
    }

    /// Returns the root mean square of the residuals in the picture (pixels).
    pub fn rms_px(&self) -> f64 {
        let all = self.residuals.iter().map(|of| of.distance_px);
        root_mean_square(all).unwrap_or_default()
    }

    /// Returns the root mean square of the residuals on the table (metres), over the poses whose
    /// lines of sight meet it. `None` if there are none.
    pub fn rms_on_table_m(&self) -> Option<f64> {
        root_mean_square(self.residuals.iter().filter_map(|of| of.table_distance_m))
    }

    /// Returns the residual of the arm pose that fits worst; `None` without poses.
    pub fn largest_residual(&self) -> Option<&BallResidual> {
        let residuals = self.residuals.iter();
        residuals.max_by(|a, b| a.distance_px.total_cmp(&b.distance_px))
    }
}

/// Returns the root mean square of `values`. `None` if there are none.
fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

/// Rejects an invalid start of the search, too few arm poses, and numbers out of range.
fn check(
    start: &CameraCalibration,
    settings: &HandEyeSettings,
    sightings: &[BallSighting],
) -> Result<(), InpaintingError> {
    start.check()?;
    settings.check()?;
    if sightings.len() < MIN_CALIBRATION_POSES {
        return Err(InpaintingError::TooFewPoses {
            got: sightings.len(),
            needed: MIN_CALIBRATION_POSES,
        });
    }
    for sighting in sightings {
        let BallSighting {
            pose_number: pose,
            hand_position: position,
            hand_rotation: rotation,
            ball_pixel: pixel,
        } = sighting;
        let value = format!("{position} in pose {pose}");
        require_that(
            has_valid_coordinates(*position),
            "position of the hand",
            &value,
            VALID_COORDINATES,
        )?;
        let turn = format!("{rotation} in pose {pose}");
        let unit = (rotation.length() - 1.0).abs() < 1e-6;
        require_that(unit, "rotation of the hand", &turn, "a unit quaternion")?;
        let seen_pixel = format!("{pixel:?} in pose {pose}");
        let finite = has_valid_coordinates(DVec3::new(pixel[0], pixel[1], 0.0));
        let expected = "a column and a row of the picture";
        require_that(finite, "pixel of the ball", &seen_pixel, expected)?;
    }
    Ok(())
}

/// Returns the best fit to all arm poses, from several starts.
///
/// # Errors
/// [`InpaintingError::HandUnseenFromStart`].
fn best<'a>(
    start: &CameraCalibration,
    settings: HandEyeSettings,
    sightings: &'a [BallSighting],
) -> Result<HandEyeFit<'a>, InpaintingError> {
    // a start that is wrong by a quarter turn or more could end in a local minimum
    let starts =
        (0..4).map(|quarter| HandEyeFit::new(rotated(start, quarter), settings, sightings));
    let fits = starts.flatten().map(minimised);
    let best = fits.min_by(|a, b| a.sum_of_squares().total_cmp(&b.sum_of_squares()));
    let best = best.ok_or_else(|| unseen(start, settings, sightings))?;
    // with all else near its value, so that the focal length is no way out of a bad start
    Ok(if settings.estimate_focal_length {
        minimised(best.with_focal_estimation(true))
    } else {
        best
    })
}

/// Arm pose without which the others fit best: the candidate for an outlier.
struct Worst {
    /// Index of the pose's sighting of the ball.
    index: usize,
    /// Distance of the pose's ball from where the other poses predict it.
    residual: BallResidual,
    /// Largest distance of that ball that counts as noise (pixels).
    limit: f64,
    /// Sum of the squared residuals of the other poses (square pixels).
    cost: f64,
    /// `true` if the other poses fit each other.
    others_fit: bool,
}

impl Worst {
    /// Finds the worst pose among the sightings of a fit; `None` if the ball would be out of sight.
    fn of(best: &HandEyeFit<'_>) -> Option<Self> {
        let sightings = best.sightings();
        let without = (0..sightings.len()).filter_map(|index| {
            let mut others = sightings.to_vec();
            let own = [others.remove(index)];
            let fit = minimised(best.with_sightings(&others)?);
            let (residual, limit) =
                fit.with_sightings(&own)?.residuals_with_noise_limits().next()?;
            let (cost, others_fit) = (fit.sum_of_squares(), fit.is_within_noise_limits());
            Some(Self { index, residual, limit, cost, others_fit })
        });
        without.min_by(|a, b| a.cost.total_cmp(&b.cost))
    }
}

/// Returns the worst pose if the others contradict it: a pose is beyond its limit, or noise would
/// hardly ever make the others fit as much better without it.
fn outlier(best: &HandEyeFit<'_>) -> Option<Worst> {
    // what outlines explain needs no search
    if best.residuals().iter().all(|of| of.distance_px < LIMIT_SIGMAS * OUTLINE_SD) {
        return None;
    }
    let worst = Worst::of(best)?;
    let count = best.sightings().len() as f64;
    // errors of outlines have a part that is no noise, so no fit counts as better than they are
    let floor = 2.0 * count * OUTLINE_SD * OUTLINE_SD;
    // survival function of Fisher's distribution with two degrees of freedom and those of the rest
    let left = best.degrees_of_freedom() - 2.0;
    let chance = ((worst.cost + floor) / (best.sum_of_squares() + floor)).powf(left / 2.0);
    (count * chance < OUTLIER || !best.is_within_noise_limits()).then_some(worst)
}

/// Returns the error of arm poses that do not fit: of one pose if the others fit each other.
fn misfit(best: &HandEyeFit<'_>, start: &CameraCalibration, worst: &Worst) -> InpaintingError {
    let BallResidual { pose_number: pose, distance_px: pixels, .. } = worst.residual;
    let limit = worst.limit;
    if worst.others_fit {
        return InpaintingError::OutlierPose { pose, pixels, limit };
    }
    let settings = *best.settings();
    let free = HandEyeSettings { ball_offset: BallOffsetInHand::Unknown, ..settings };
    let fit = self::best(start, free, best.sightings()).ok();
    let fit = fit.filter(|fit| {
        settings.ball_offset != BallOffsetInHand::Unknown && fit.is_within_noise_limits()
    });
    InpaintingError::InconsistentPoses {
        pose,
        pixels,
        limit,
        accuracy: settings.arm_position_sd,
        fitted: fit.map(|fit| fit.ball_offset()),
    }
}

/// Returns the fit that minimises the sum of squared residuals, by the Levenberg-Marquardt method.
fn minimised(mut fit: HandEyeFit<'_>) -> HandEyeFit<'_> {
    let [mut damping, largest, factor] = DAMPING;
    for _ in 0..STEPS {
        let equations = fit.normal_equations();
        // a larger damping shortens the step, until it no longer increases the cost
        let step = loop {
            let better = equations.solve(damping).and_then(|step| fit.after_step(&step));
            match better.filter(|better| better.sum_of_squares() <= fit.sum_of_squares()) {
                Some(better) => break Some(better),
                None if damping >= largest => break None,
                None => damping *= factor,
            }
        };
        let Some(better) = step else {
            break;
        };
        let converged =
            fit.sum_of_squares() - better.sum_of_squares() <= CONVERGED * fit.sum_of_squares();
        fit = better;
        damping /= factor;
        if converged {
            break;
        }
    }
    fit
}

/// Estimates the focal length, by solving again with it among the unknowns; `None` if the arm poses
/// do not determine it.
fn focal(best: &HandEyeFit<'_>, start: &CameraCalibration) -> Option<FocalLengthEstimate> {
    let fit = minimised(best.with_focal_estimation(true));
    let variance = fit.normal_equations().variances()?[fit.focal_length_index()];
    let ratio = fit.calibration().intrinsics.focal_lengths[0] / start.intrinsics.focal_lengths[0];
    // the unknown is the logarithm of the focal length
    let sigma = ratio * fit.noise_sd() * variance.sqrt();
    Some(FocalLengthEstimate { ratio_to_given: ratio, ratio_sd: sigma })
}

/// Rejects given focal lengths that the estimate contradicts.
fn check_focal(
    focal: FocalLengthEstimate,
    start: &CameraCalibration,
) -> Result<(), InpaintingError> {
    let [sigmas, part] = WRONG_FOCAL;
    let off = (focal.ratio_to_given - 1.0).abs();
    if off <= part || off <= sigmas * focal.ratio_sd {
        return Ok(());
    }
    let given = start.intrinsics.focal_lengths;
    Err(InpaintingError::WrongFocalLength {
        given,
        fitted: given.map(|given| focal.ratio_to_given * given),
        sigma: focal.ratio_sd * given[0],
    })
}

/// Returns the standard deviations of the unknowns that a pixel of noise causes; `None` if the arm
/// poses do not determine all unknowns.
fn dilution_of(fit: &HandEyeFit<'_>) -> Option<HandEyeUncertainty> {
    let mut variances = fit.normal_equations().variances()?;
    // where the offset is known, the focal length is in its place
    variances[fit.focal_length_index()] = 0.0;
    let of = |first: usize| DVec3::from_slice(&variances[first..]).map(f64::sqrt);
    Some(HandEyeUncertainty { angle_sd: of(0), position_sd: of(3), ball_offset_sd: of(6) })
}

/// Returns `true` if the standard deviations that a pixel of noise causes are within
/// [`MAX_DILUTION`].
fn is_tolerable(dilution: &HandEyeUncertainty) -> bool {
    let [distance, angle] = MAX_DILUTION;
    let lengths = [dilution.position_sd.length(), dilution.ball_offset_sd.length()];
    lengths.iter().all(|length| *length <= distance) && dilution.angle_sd.length() <= angle
}

/// Returns the error of arm poses that do not determine the camera's pose, with advice.
fn undetermined(fit: &HandEyeFit<'_>) -> InpaintingError {
    let would_suffice =
        |other: &HandEyeFit<'_>| dilution_of(other).is_some_and(|of| is_tolerable(&of));
    InpaintingError::CameraPoseUndetermined {
        advice: if fit.settings().estimate_focal_length
            && would_suffice(&fit.with_focal_estimation(false))
        {
            "they do not separate the focal length from the height: spread them over heights and \
                 turn the hand further, or give the focal lengths"
        } else if would_suffice(&fit.with_known_offset().with_focal_estimation(false)) {
            // the hand turns too little
            "the hand turns too little to separate the ball's offset from the camera's position: \
                 turn it about two axes, by 10 degrees and more, or measure the offset and give it"
        } else {
            "the positions of the ball are nearly one line or one point: spread them over the \
                 table and over heights"
        },
    }
}

/// Returns the error of a start from which the camera does not see a hand, with the number of the
/// first such arm pose.
fn unseen(
    start: &CameraCalibration,
    settings: HandEyeSettings,
    sightings: &[BallSighting],
) -> InpaintingError {
    let is_unseen = |sighting: &&BallSighting| {
        HandEyeFit::new(*start, settings, std::slice::from_ref(*sighting)).is_none()
    };
    let pose = sightings.iter().find(is_unseen).map(|sighting| sighting.pose_number);
    InpaintingError::HandUnseenFromStart { pose: pose.unwrap_or_default() }
}

#[cfg(test)]
mod tests;

//! Where a camera is that watches an arm: solved for from pictures of a ball that the arm carries.

mod equations;
mod model;

use glam::DVec3;

use crate::calibration::Calibration;
use crate::camera::{NEAR, is_near};
use crate::error::{InpaintingError, require};

use equations::UNKNOWNS;
use model::{Fit, turned};

pub use model::{LARGEST_RESIDUAL, Offset, Residual, Sighting};

/// Fewest poses that a camera's place is solved for from.
pub const LEAST_POSES: usize = 10;
/// Largest uncertainty that a pixel of noise may leave: of places (metres) and of angles (radians).
const LARGEST_DILUTION: [f64; 2] = [0.1, 5.0 * std::f64::consts::PI / 180.0];
/// Most steps of Levenberg's and Marquardt's method.
const STEPS: usize = 200;
/// Its first damping, its largest, and the factor from one to the next.
const DAMPING: [f64; 3] = [1e-3, 1e12, 10.0];
/// Standard deviations from which on a focal length is wrong, and the least part by which it then
/// is: lenses that are not quite as the calibration has them leave less.
const WRONG_FOCAL: [f64; 2] = [3.5, 0.01];
/// A step that lowers the sum of squares by less than this part of it is the last one.
const SETTLED: f64 = 1e-12;

/// One standard deviation of what was solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Of the camera's place (metres, world).
    pub position: DVec3,
    /// Of its angles about its own axes, right, down and forwards (radians).
    pub angle: DVec3,
    /// Of the ball's place in the hand (metres); zero where that was known.
    pub offset: DVec3,
}

/// Focal length that the poses themselves tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focal {
    /// Ratio of this focal length to the one that was given.
    pub ratio: f64,
    /// One standard deviation of the ratio.
    pub sigma: f64,
}

/// A camera that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEye {
    /// The camera; lens and intrinsics are those that were given.
    pub calibration: Calibration,
    /// Where the ball is in the frame of the hand (metres).
    pub offset: DVec3,
    /// Of every pose, in the order given.
    pub residuals: Vec<Residual>,
    /// Uncertainty by the residuals themselves, for the focal lengths that were given.
    pub uncertainty: Uncertainty,
    /// Check of the focal lengths; none where the poses do not tell them.
    pub focal: Option<Focal>,
    /// What a pixel of noise would leave: how well the poses are spread.
    pub dilution: Uncertainty,
}

impl HandEye {
    /// The camera that sees the balls where they were seen, as far as least squares can have it.
    ///
    /// It minimises the squared distances in the picture by Levenberg's and Marquardt's method
    /// (Moré 1978, "The Levenberg-Marquardt algorithm"), from `start` and from `start` turned by
    /// quarters about the optical axis. Lens and intrinsics are those of `start`.
    ///
    /// # Errors
    /// [`InpaintingError::TooFewPoses`], [`InpaintingError::Value`] for numbers out of range,
    /// [`InpaintingError::Unseen`] where `start` looks elsewhere, [`InpaintingError::Misfit`] for a
    /// residual of more than [`LARGEST_RESIDUAL`], [`InpaintingError::Undetermined`] for poses that
    /// do not tell the camera's place, and [`InpaintingError::WrongFocal`] for a focal length that
    /// the poses contradict.
    pub fn solve(
        start: &Calibration,
        offset: Offset,
        sightings: &[Sighting],
    ) -> Result<Self, InpaintingError> {
        check(start, offset, sightings)?;
        let quarters = (0..4).map(|quarter| Fit::new(turned(start, quarter), offset, sightings));
        let solved = quarters.flatten().map(settle);
        let best = solved.min_by(|a, b| a.cost().total_cmp(&b.cost()));
        let best = best.ok_or_else(|| unseen(start, offset, sightings))?;
        best.check_misfit()?;
        let variances = best.equations().variances();
        let dilution = variances.map(|variances| dilution_of(&variances));
        let dilution = dilution.filter(tolerable);
        let dilution = dilution.ok_or_else(|| undetermined(&best))?;
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

    /// Root of the mean square of the residuals in the picture (pixels).
    pub fn rms(&self) -> f64 {
        let all = self.residuals.iter().map(|of| of.pixels);
        root_mean_square(all).unwrap_or_default()
    }

    /// Root of the mean square on the table (metres), of the poses whose lines of sight meet it;
    /// none of none.
    pub fn rms_on_table(&self) -> Option<f64> {
        root_mean_square(self.residuals.iter().filter_map(|of| of.on_table))
    }

    /// The largest residual; none of no poses.
    pub fn worst(&self) -> Option<&Residual> {
        let residuals = self.residuals.iter();
        residuals.max_by(|a, b| a.pixels.total_cmp(&b.pixels))
    }
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let squares: Vec<f64> = values.map(|value| value * value).collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

fn check(
    start: &Calibration,
    offset: Offset,
    sightings: &[Sighting],
) -> Result<(), InpaintingError> {
    start.check()?;
    if sightings.len() < LEAST_POSES {
        return Err(InpaintingError::TooFewPoses { got: sightings.len(), needed: LEAST_POSES });
    }
    if let Offset::Known(offset) = offset {
        require(is_near(offset), "offset of the ball", &offset, NEAR)?;
    }
    for sighting in sightings {
        let Sighting { pose, position, rotation, pixel } = sighting;
        let value = format!("{position} in pose {pose}");
        require(is_near(*position), "position of the hand", &value, NEAR)?;
        let value = format!("{rotation} in pose {pose}");
        let unit = (rotation.length() - 1.0).abs() < 1e-6;
        require(unit, "rotation of the hand", &value, "a unit quaternion")?;
        let value = format!("{pixel:?} in pose {pose}");
        let finite = is_near(DVec3::new(pixel[0], pixel[1], 0.0));
        let expected = "a column and a row of the picture";
        require(finite, "pixel of the ball", &value, expected)?;
    }
    Ok(())
}

/// Levenberg's and Marquardt's method, until it settles.
fn settle(mut fit: Fit<'_>) -> Fit<'_> {
    let [mut damping, largest, factor] = DAMPING;
    for _ in 0..STEPS {
        let equations = fit.equations();
        let step = loop {
            let better = equations.solve(damping).and_then(|step| fit.moved(&step));
            match better.filter(|better| better.cost() <= fit.cost()) {
                Some(better) => break Some(better),
                None if damping >= largest => break None,
                None => damping *= factor,
            }
        };
        let Some(better) = step else {
            break;
        };
        let settled = fit.cost() - better.cost() <= SETTLED * fit.cost();
        fit = better;
        damping /= factor;
        if settled {
            break;
        }
    }
    fit
}

/// Solves once more with the focal length among the unknowns.
fn focal(best: &Fit<'_>) -> Option<Focal> {
    let fit = settle(best.with_free_focal());
    let variance = fit.equations().variances()?[fit.focal_index()];
    let focal = |fit: &Fit<'_>| fit.calibration().intrinsics.focal[0];
    let ratio = focal(&fit) / focal(best);
    let sigma = ratio * fit.noise() * variance.sqrt();
    Some(Focal { ratio, sigma })
}

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

fn dilution_of(variances: &[f64; UNKNOWNS]) -> Uncertainty {
    let of = |first: usize| DVec3::from_slice(&variances[first..]).map(f64::sqrt);
    Uncertainty { angle: of(0), position: of(3), offset: of(6) }
}

fn tolerable(dilution: &Uncertainty) -> bool {
    let [place, angle] = LARGEST_DILUTION;
    let lengths = [dilution.position.length(), dilution.offset.length()];
    lengths.iter().all(|length| *length <= place) && dilution.angle.length() <= angle
}

/// Says whether it is the ball's offset that the poses leave open.
fn undetermined(fit: &Fit<'_>) -> InpaintingError {
    let known = fit.with_known_offset().equations().variances();
    let would_do = known.is_some_and(|variances| tolerable(&dilution_of(&variances)));
    InpaintingError::Undetermined {
        advice: if would_do {
            "the hand turns too little to tell the ball's offset from the camera's place: turn \
                 it about two axes, by 10 degrees and more, or measure the offset and give it"
        } else {
            "the places of the ball are nearly one line or one point: spread them over the \
                 table and over heights"
        },
    }
}

/// The first pose that the camera does not see as it is said to hang.
fn unseen(start: &Calibration, offset: Offset, sightings: &[Sighting]) -> InpaintingError {
    let alone =
        |sighting: &&Sighting| Fit::new(*start, offset, std::slice::from_ref(*sighting)).is_none();
    let pose = sightings.iter().find(alone).map(|sighting| sighting.pose);
    InpaintingError::Unseen { pose: pose.unwrap_or_default() }
}

#[cfg(test)]
mod tests;

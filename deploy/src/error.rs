//! Errors of this crate.

use std::path::PathBuf;
use std::time::Duration;

use envs::TaskGroup;
use experiments::RunError;
use glam::DVec3;
use learner::LearnerError;
use render::RenderError;
use rl::BoxedEnvError;

/// Error of a trial on a robot, or of calibrating its camera.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeployError {
    /// Error of the run whose policies act.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Error while a film is made.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Error of the environments.
    #[error(transparent)]
    Env(#[from] envs::EnvError),
    /// Error of the perception or of the camera's calibration.
    #[error(transparent)]
    Inpainting(#[from] inpainting::InpaintingError),
    /// Error of the robot or its control.
    #[error(transparent)]
    Robot(#[from] robots::ControlError),
    /// Error of the rig: its table, its camera or its clock.
    #[error("the rig failed: {source}")]
    Rig {
        /// Cause of the rig's failure.
        source: BoxedEnvError,
    },
    /// Camera whose latest picture is too old.
    #[error(
        "the camera's newest picture is {} ms old, expected at most {} ms",
        age.as_millis(), max_age.as_millis()
    )]
    StalePicture {
        /// Age of the camera's latest picture.
        age: Duration,
        /// Maximum accepted age of a picture.
        max_age: Duration,
    },
    /// Camera whose clock is ahead of the robot's.
    #[error(
        "the camera's newest picture has a time {} ms in the future: expected one clock for robot and \
         camera",
        ahead.as_millis()
    )]
    CameraClockAhead {
        /// Time from now to the picture's time stamp, which lies in the future.
        ahead: Duration,
    },
    /// Hand that did not reach a pose in time.
    #[error(
        "the hand did not reach its target within 20 s: {remaining_mm:.0} mm and \
         {remaining_deg:.0} degrees are left"
    )]
    PoseNotReached {
        /// Remaining distance of the hand from the pose (mm).
        remaining_mm: f64,
        /// Remaining angle between the hand and the pose (degrees).
        remaining_deg: f64,
    },
    /// Hand that kept moving after the robot was stopped.
    #[error("the hand does not come to rest within 2 s of a stop")]
    HandNotAtRest,
    /// Calibration ball that was seen in too few poses.
    #[error(
        "the ball was seen in {sightings} poses, expected at least {needed}; pose {skipped_pose} \
         was left out: {reason}"
    )]
    TooFewSightings {
        /// Number of poses in which the ball was seen.
        sightings: usize,
        /// Minimum number of poses in which the ball must be seen.
        needed: usize,
        /// Number of the first pose that was skipped, counted from 1.
        skipped_pose: usize,
        /// Reason for which that pose was skipped.
        reason: String,
    },
    /// Calibration file that does not fit the rig.
    #[error("`{}`: {source}", .path.display())]
    CalibrationFile {
        /// Path of the calibration file.
        path: PathBuf,
        /// Reason for which the calibration does not fit the rig.
        source: Box<DeployError>,
    },
    /// Goal of a rig that no trial can have.
    #[error("the rig's goal is {goal} m, expected {expected}")]
    ImplausibleGoal {
        /// Goal of the rig (metres).
        goal: DVec3,
        /// Allowed goals, in words.
        expected: String,
    },
    /// Trial of a task with an observed goal, for which the rig has none.
    #[error(
        "the rig has no goal, expected one in `PreparedTrial::goal`: policies of {group} see it"
    )]
    MissingGoal {
        /// Group of the trial.
        group: TaskGroup,
    },
    /// State of the robot with another number of joints than the arm has.
    #[error(
        "the robot reports {got} joint positions, expected {expected}, one for each joint that moves"
    )]
    JointCount {
        /// Number of joint positions that the robot reports.
        got: usize,
        /// Number of joints that move.
        expected: usize,
    },
    /// State of the robot whose hand is not where the arm's model has it.
    #[error(
        "the robot reports its hand {way_mm:.0} mm and {turn_deg:.1} degrees from where the arm's \
         model places it: expected joints in radians, lengths in metres, the hand in the \
         frame of the table, and the model of this robot"
    )]
    ImplausibleState {
        /// Distance of the two hands (mm).
        way_mm: f64,
        /// Angle between the two hands (degrees).
        turn_deg: f64,
    },
    /// First picture of a camera that does not show the table of the training.
    #[error(
        "the camera's first picture does not show the table of the training: beside it, its {part} \
         is {value:.3}, expected {expected}. Look at the picture, and correct the light, the \
         surface of the table or the calibration"
    )]
    UnknownTable {
        /// Name of the property: brightness and tint relative to the training's, or share of the
        /// picture that looks like the table.
        part: &'static str,
        /// Value of the property.
        value: f64,
        /// Bound of the value, in words.
        expected: &'static str,
    },
    /// Calibration that cannot be that of the rig's camera.
    #[error(
        "the calibration is not of this rig's camera: its {part} is {value}, expected {expected}. \
         Make a new one with `covers calibrate` and try it with `covers check mask`; if it is \
         right, correct what the rig says of its camera"
    )]
    ImplausibleCalibration {
        /// Name of the implausible part of the calibration.
        part: &'static str,
        /// Value of the implausible part.
        value: String,
        /// Description of plausible values of the part.
        expected: String,
    },
}

impl From<LearnerError> for DeployError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}

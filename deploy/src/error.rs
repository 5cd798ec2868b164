//! Errors of this crate.

use std::time::Duration;

use experiments::RunError;
use learner::LearnerError;
use render::RenderError;
use rl::BoxError;

/// Error of a trial on a robot, or of a calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeployError {
    /// A run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A film.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The environments.
    #[error(transparent)]
    Env(#[from] envs::EnvError),
    /// What a camera's pictures are made into.
    #[error(transparent)]
    Inpainting(#[from] inpainting::InpaintingError),
    /// A robot.
    #[error(transparent)]
    Robot(#[from] robots::ControlError),
    /// A robot's rig: its table, its camera, its clock.
    #[error("the rig failed: {source}")]
    Rig {
        /// The reason.
        source: BoxError,
    },
    /// A camera that shows the past.
    #[error(
        "the camera's newest picture is {} ms old, expected at most {} ms",
        age.as_millis(), most.as_millis()
    )]
    StalePicture {
        /// The picture's age.
        age: Duration,
        /// The age at which the arm is stopped.
        most: Duration,
    },
    /// A camera with another clock than the robot's.
    #[error(
        "the camera's newest picture was taken {} ms from now: expected one clock for robot and camera",
        ahead.as_millis()
    )]
    PictureOfTheFuture {
        /// How far ahead it is.
        ahead: Duration,
    },
    /// A hand that does not come to where it is sent.
    #[error(
        "the hand does not get to where it is sent: {left:.0} mm and {turn:.0} degrees are left \
         after 20 s"
    )]
    Unreached {
        /// What is left of the way (mm).
        left: f64,
        /// What is left of the turn (degrees).
        turn: f64,
    },
    /// A hand that does not stand.
    #[error("the hand does not come to rest within 2 s of being told to stop")]
    Restless,
    /// A ball that was seen too seldom to find the camera by.
    #[error(
        "the ball was seen in {got} poses, expected at least {needed}; pose {pose} was left out: \
         {why}"
    )]
    FewSightings {
        /// Poses in which it was seen.
        got: usize,
        /// Poses that it takes.
        needed: usize,
        /// Number of the first pose that was left out.
        pose: usize,
        /// Why it was.
        why: String,
    },
    /// A calibration that cannot be of the rig's camera.
    #[error(
        "the calibration is not of this rig's camera: its {what} is {value}, expected {expected}. \
         Make a new one with `covers calibrate` and try it with `covers check mask`; if it is \
         right, correct what the rig says of its camera"
    )]
    OtherCamera {
        /// Part of the calibration.
        what: &'static str,
        /// Value of that part.
        value: String,
        /// Values that would be accepted.
        expected: String,
    },
}

impl From<LearnerError> for DeployError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}

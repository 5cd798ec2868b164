//! What a robot needs around it for trials.

use std::time::Duration;

use envs::{TaskGroup, TaskVariant};
use glam::DVec3;
use inpainting::Calibration;
use rl::BoxError;
use robots::{ControlError, Robot, RobotState};
use symmetry::D2;

use crate::DeployError;

/// One episode on a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// What stands on the table. Whoever sets the table must know; the policy is not told.
    pub variant: TaskVariant,
    /// Which trial of the variant it is; each has a placement of its own.
    pub number: usize,
    /// Seed of all that is random.
    pub seed: u64,
}

impl Trial {
    /// One of a task that puts nothing on the table.
    pub fn on_empty_table(seed: u64) -> Self {
        Self {
            variant: TaskVariant { group: TaskGroup::GOAL_REACH, element: D2::Identity },
            number: 0,
            seed,
        }
    }
}

/// A table that is set.
#[derive(Clone, Debug, PartialEq)]
pub struct SetUp {
    /// The camera's picture `[H, W, 3]` of the table with its things, the arm parked beside it.
    pub background: Vec<u8>,
    /// Where the arm was parked.
    pub parked: RobotState,
    /// Where the hand shall go (metres, world), in tasks in which that is told.
    pub goal: Option<DVec3>,
}

/// How a task stands, as somebody sees who does not tell the policy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Whether the task was solved at any time since the last verdict.
    pub success: bool,
    /// Whether it is solved.
    pub success_at_end: bool,
}

/// Stops the robot once something is done, whatever came of it.
///
/// # Errors
/// What came of it; [`ControlError::NotStopped`] where the robot cannot be stopped after an error.
pub(super) fn then_stop<T>(
    rig: &mut dyn Rig,
    done: Result<T, DeployError>,
) -> Result<T, DeployError> {
    match (done, rig.stop()) {
        (Err(error), Err(source)) => {
            Err(ControlError::NotStopped { cause: error.to_string(), source: Box::new(source) }
                .into())
        }
        (done, Ok(())) => done,
        (Ok(_), Err(source)) => Err(source.into()),
    }
}

/// A picture that is older stops the arm.
pub(super) const OLDEST: Duration = Duration::from_millis(500);

/// Copies the camera's newest picture into `rgb`, and says when it was taken.
///
/// # Errors
/// [`DeployError::Rig`]; [`DeployError::PictureOfTheFuture`] for a camera whose clock is ahead.
pub(super) fn newest_picture(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<Duration, DeployError> {
    let taken = rig.picture(rgb);
    let taken = taken.map_err(|source| DeployError::Rig { source })?;
    let now = rig.now();
    if taken > now {
        let ahead = taken - now;
        return Err(DeployError::PictureOfTheFuture { ahead });
    }
    Ok(taken)
}

/// Copies the newest picture, as [`newest_picture`] does, and refuses one older than [`OLDEST`].
///
/// # Errors
/// As [`newest_picture`]; [`DeployError::StalePicture`].
pub(super) fn fresh_picture(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<Duration, DeployError> {
    let taken = newest_picture(rig, rgb)?;
    let (age, most) = (rig.now() - taken, OLDEST);
    match age > most {
        true => Err(DeployError::StalePicture { age, most }),
        false => Ok(taken),
    }
}

/// A robot with its table, its camera and its clock.
///
/// All places are in the frame of the policy: its origin is the middle of the table, x points
/// right, y away from the robot, and z up. The [`Robot`] keeps the twist that it was commanded, so
/// it must stop by itself where nobody commands it. A [`Watchdog`](robots::Watchdog) does so only
/// where somebody asks it in time: give it a thread of its own where a camera may block.
pub trait Rig: Robot {
    /// Sets the table for a trial, takes a picture of it with the arm parked, and brings the arm to
    /// its start. There it rests when this returns, and the camera's newest picture shows it.
    ///
    /// # Errors
    /// Whatever the rig cannot do.
    fn set_up(&mut self, trial: &Trial) -> Result<SetUp, BoxError>;

    /// What is known of the camera, from the last [`Rig::set_up`] on. A rehearsal asks without one.
    fn calibration(&self) -> Calibration;

    /// Estimate of the camera that is the same for all trials, asked for before [`Rig::set_up`]. A
    /// calibration from a file is held to it. By default it is [`Rig::calibration`], which must
    /// then answer at any time.
    fn standing_calibration(&self) -> Calibration {
        self.calibration()
    }

    /// Time since some moment; it does not go back.
    fn now(&self) -> Duration;

    /// Lets so much time pass while the robot moves.
    ///
    /// # Errors
    /// Whatever the rig cannot do.
    fn wait(&mut self, time: Duration) -> Result<(), BoxError>;

    /// Copies the camera's newest picture into `rgb` `[H, W, 3]`, and says when it was taken.
    ///
    /// # Errors
    /// Whatever the rig cannot do.
    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxError>;

    /// How the task stands. It is asked after every decision, while the arm moves on, so it must
    /// answer at once. The policy does not see it.
    ///
    /// # Errors
    /// Whatever the rig cannot do.
    fn verdict(&mut self) -> Result<Verdict, BoxError>;
}

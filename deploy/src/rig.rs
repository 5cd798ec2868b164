//! Interface of a robot with its table, camera and clock, and the description of a trial.

use std::time::Duration;

use envs::{TaskGroup, TaskVariant};
use glam::DVec3;
use inpainting::CameraCalibration;
use rl::BoxedEnvError;
use robots::{ControlError, Robot, RobotState};
use symmetry::D2;

use crate::DeployError;

/// Description of one trial (episode) on a robot: its task variant, index and seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Task variant to set up. The policy does not see it.
    pub variant: TaskVariant,
    /// Index of the trial of this variant; each has its own placement.
    pub index: usize,
    /// Seed of the trial's placement and faults.
    pub seed: u64,
}

impl Trial {
    /// Returns a trial of a task that puts nothing on the table.
    pub fn on_empty_table(seed: u64) -> Self {
        Self {
            variant: TaskVariant { group: TaskGroup::GOAL_REACH, element: D2::Identity },
            index: 0,
            seed,
        }
    }
}

/// Table that was set up for a trial: its picture, the parked arm and the goal.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedTrial {
    /// Picture `[H, W, 3]` of the table with its objects, taken with the arm parked outside of it.
    pub background: Vec<u8>,
    /// State of the arm while it is parked outside of the picture.
    pub parked_state: RobotState,
    /// Goal position of the hand (metres, world); `None` in tasks whose policy does not observe it.
    pub goal: Option<DVec3>,
}

/// Success of a task, judged by an observer outside of the policy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TaskVerdict {
    /// `true` if the task was solved at any time since the last verdict.
    pub success: bool,
    /// `true` if the task is solved now.
    pub success_at_end: bool,
}

/// Stops the robot after an operation, whether it succeeded or failed, and returns the operation's
/// result `done`.
///
/// # Errors
/// Error of the operation, or else of the stop; [`ControlError::NotStopped`] if both failed.
pub(super) fn stop_after<T>(
    rig: &mut dyn Rig,
    done: Result<T, DeployError>,
) -> Result<T, DeployError> {
    // also after an error, which must not leave the arm moving
    match (done, rig.stop()) {
        (Err(error), Err(source)) => {
            Err(ControlError::NotStopped { cause: error.to_string(), source: Box::new(source) }
                .into())
        }
        (done, Ok(())) => done,
        (Ok(_), Err(source)) => Err(source.into()),
    }
}

/// Maximum age of a picture; an older one stops the arm.
pub(super) const MAX_PICTURE_AGE: Duration = Duration::from_millis(500);

/// Copies the camera's latest picture into `rgb` `[H, W, 3]` and returns the time at which it was
/// taken.
///
/// # Errors
/// [`DeployError::Rig`]; [`DeployError::CameraClockAhead`] for a camera whose clock is ahead.
pub(super) fn newest_picture(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<Duration, DeployError> {
    let taken = rig.picture(rgb).map_err(|source| DeployError::Rig { source })?;
    let now = rig.now();
    // with a clock that is ahead, old pictures would look fresh
    if taken > now {
        let ahead = taken - now;
        return Err(DeployError::CameraClockAhead { ahead });
    }
    Ok(taken)
}

/// Copies the camera's latest picture into `rgb` and returns the time at which it was taken;
/// rejects one older than [`MAX_PICTURE_AGE`].
///
/// # Errors
/// As [`newest_picture`]; [`DeployError::StalePicture`].
pub(super) fn fresh_picture(rig: &mut dyn Rig, rgb: &mut [u8]) -> Result<Duration, DeployError> {
    let taken = newest_picture(rig, rgb)?;
    let (age, max_age) = (rig.now() - taken, MAX_PICTURE_AGE);
    if age > max_age { Err(DeployError::StalePicture { age, max_age }) } else { Ok(taken) }
}

/// Robot with its table, its camera and its clock, on which trials run.
///
/// All positions are in the policy's frame: the origin is the middle of the table, x points right,
/// y away from the robot, and z up. The [`Robot`] keeps the last commanded twist, so it must stop
/// by itself when commands cease. A [`Watchdog`](robots::Watchdog) does so only if it is polled in
/// time: poll it from its own thread if the camera may block.
pub trait Rig: Robot {
    /// Sets the table up for a trial, takes a picture of it with the arm parked, and moves the arm
    /// to its start. On return, the arm rests there and the camera's latest picture shows it.
    ///
    /// # Errors
    /// Errors of the hardware.
    fn set_up(&mut self, trial: &Trial) -> Result<PreparedTrial, BoxedEnvError>;

    /// Returns the estimated calibration of the camera since the last [`Rig::set_up`]. A dry run
    /// calls this without a set-up.
    fn calibration(&self) -> CameraCalibration;

    /// Returns the estimated calibration that is the same for all trials. A calibration from a file
    /// is compared with it, before [`Rig::set_up`]. The default is [`Rig::calibration`], which must
    /// then work at any time.
    fn trial_independent_calibration(&self) -> CameraCalibration {
        self.calibration()
    }

    /// Returns the time on the rig's clock since a fixed moment. It never decreases.
    fn now(&self) -> Duration;

    /// Waits for a time while the robot keeps moving.
    ///
    /// # Errors
    /// Errors of the hardware.
    fn wait(&mut self, time: Duration) -> Result<(), BoxedEnvError>;

    /// Copies the camera's latest picture into `rgb` `[H, W, 3]` and returns the time at which it
    /// was taken.
    ///
    /// # Errors
    /// Errors of the hardware.
    fn picture(&mut self, rgb: &mut [u8]) -> Result<Duration, BoxedEnvError>;

    /// Returns the success of the task, which the policy does not see. Called after every decision
    /// while the arm moves, so it must not block.
    ///
    /// # Errors
    /// Errors of the hardware.
    fn verdict(&mut self) -> Result<TaskVerdict, BoxedEnvError>;
}

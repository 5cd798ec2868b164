//! What every robot can do, simulated or real.

use crate::error::ControlError;
use crate::pose::Pose;
use crate::twist::Twist;

/// What a robot is told: how its tip moves, and how far its gripper closes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Twist of the tip, with the axes of the world.
    pub twist: Twist,
    /// Where the fingers go: 0 is open, 1 is closed.
    pub closing: f64,
}

impl Command {
    /// Refuses numbers that are not finite, and a closing out of range.
    ///
    /// # Errors
    /// [`ControlError::NotFinite`], [`ControlError::Setting`].
    pub fn check(&self) -> Result<(), ControlError> {
        crate::control::check_twist(&self.twist)?;
        if (0.0..=1.0).contains(&self.closing) {
            return Ok(());
        }
        Err(ControlError::Setting {
            name: "closing",
            value: self.closing.to_string(),
            expected: "0 (open) to 1 (closed)",
        })
    }
}

/// What a robot tells of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotState {
    /// Positions of its joints (radians, metres), from the base to the tip.
    pub joints: Vec<f64>,
    /// Frame of its tip in the world.
    pub tip: Pose,
    /// Where its fingers are: 0 is open, 1 is closed.
    pub closing: f64,
}

/// A robot that moves its tip by twists.
///
/// A command stays in force until the next one, or until the robot is stopped, as on the arms that
/// it stands for. A [`Watchdog`](crate::Watchdog) stops a robot that nobody commands any more.
pub trait Robot {
    /// Where the robot is.
    ///
    /// # Errors
    /// [`ControlError::Driver`], or why the robot stopped by itself since the last call.
    fn state(&mut self) -> Result<RobotState, ControlError>;

    /// Moves the tip by a twist, and the fingers.
    ///
    /// # Errors
    /// A [`ControlError`], and the robot stands still.
    fn command(&mut self, command: &Command) -> Result<(), ControlError>;

    /// Stops all motion.
    ///
    /// # Errors
    /// [`ControlError::Driver`], and the robot may be moving.
    fn stop(&mut self) -> Result<(), ControlError>;
}

impl<R: Robot + ?Sized> Robot for Box<R> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        (**self).state()
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        (**self).command(command)
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        (**self).stop()
    }
}

//! Interface of every robot, simulated or real.

use crate::error::ControlError;
use crate::pose::Pose;
use crate::twist::Twist;

/// Command to a robot: twist of its tip and target of its gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmCommand {
    /// Twist of the tip, along the axes of the world.
    pub twist: Twist,
    /// Target of the fingers, in [0, 1]: 0 is open, 1 is closed.
    pub gripper_closure: f64,
}

impl ArmCommand {
    /// Rejects a twist that is not finite, and a gripper closure out of range.
    ///
    /// # Errors
    /// [`ControlError::NotFinite`], [`ControlError::InvalidSetting`].
    pub fn check(&self) -> Result<(), ControlError> {
        crate::control::check_twist(&self.twist)?;
        if (0.0..=1.0).contains(&self.gripper_closure) {
            return Ok(());
        }
        Err(ControlError::InvalidSetting {
            name: "gripper_closure",
            value: self.gripper_closure.to_string(),
            expected: "0 (open) to 1 (closed)",
        })
    }
}

/// Measured state of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotState {
    /// Positions of the joints (radians, metres), from the base to the tip.
    pub joints: Vec<f64>,
    /// Pose of the tip in the world.
    pub tip: Pose,
    /// Position of the fingers, in [0, 1]: 0 is open, 1 is closed.
    pub gripper_closure: f64,
}

/// Robot that moves its tip by twists.
///
/// A command stays in force until the next one or until the robot is stopped, as on real arms. A
/// [`Watchdog`](crate::Watchdog) that is polled stops a robot that receives no commands any more.
pub trait Robot {
    /// Reads the state of the robot.
    ///
    /// # Errors
    /// [`ControlError::Driver`], or the reason for which the robot stopped by itself since the last
    /// call.
    fn state(&mut self) -> Result<RobotState, ControlError>;

    /// Moves the tip by a twist, and the fingers.
    ///
    /// # Errors
    /// A [`ControlError`]; the robot stands still then.
    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError>;

    /// Stops all motion.
    ///
    /// # Errors
    /// [`ControlError::Driver`]; the robot may still be moving then.
    fn stop(&mut self) -> Result<(), ControlError>;
}

impl<R: Robot + ?Sized> Robot for Box<R> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        (**self).state()
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        (**self).command(command)
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        (**self).stop()
    }
}

//! Purely kinematic arm, for dry runs.

use crate::control::TwistController;
use crate::error::ControlError;
use crate::robot::{ArmCommand, Robot, RobotState};

/// Time (seconds) in which the fingers close: a Robotiq 2F-85 at full speed.
const CLOSING_TIME: f64 = 0.57;

/// Robot without dynamics that is always exactly at its references, for dry runs and tests.
///
/// Its time passes in [`KinematicArm::advance`].
#[derive(Debug)]
pub struct KinematicArm {
    control: TwistController,
    wanted_closing: f64,
    gripper_closure: f64,
}

impl KinematicArm {
    /// Creates an arm whose joints are at the target positions that `control` holds, with open
    /// fingers.
    pub fn new(control: TwistController) -> Self {
        Self { control, wanted_closing: 0.0, gripper_closure: 0.0 }
    }

    /// Moves arm and fingers for `seconds` as they were last commanded.
    ///
    /// # Errors
    /// Errors of [`TwistController::tick`]; the arm stands still then.
    pub fn advance(&mut self, seconds: f64) -> Result<(), ControlError> {
        let moved = self.control.tick(seconds);
        self.unless_failed(moved)?;
        let max_change = seconds / CLOSING_TIME;
        self.gripper_closure +=
            (self.wanted_closing - self.gripper_closure).clamp(-max_change, max_change);
        Ok(())
    }

    /// Stops arm and fingers if `outcome` is an error, and returns it.
    fn unless_failed(&mut self, outcome: Result<(), ControlError>) -> Result<(), ControlError> {
        if outcome.is_err() {
            self.stop()?;
        }
        outcome
    }

    /// Returns the controller that turns commands into joint positions.
    pub fn controller(&self) -> &TwistController {
        &self.control
    }
}

impl Robot for KinematicArm {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        Ok(RobotState {
            joints: self.control.joint_positions().to_vec(),
            tip: self.control.tip_pose(),
            gripper_closure: self.gripper_closure,
        })
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        let checked = command.check();
        let sent = checked.and_then(|()| self.control.command_twist(command.twist));
        self.unless_failed(sent)?;
        self.wanted_closing = command.gripper_closure;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.control.stop();
        // the fingers stop where they are, too
        self.wanted_closing = self.gripper_closure;
        Ok(())
    }
}

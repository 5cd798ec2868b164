//! An arm without masses, for dry runs.

use crate::control::CartesianControl;
use crate::error::ControlError;
use crate::robot::{Command, Robot, RobotState};

/// Seconds in which fingers close: a Robotiq 2F-85 at full speed.
const CLOSING_TIME: f64 = 0.57;

/// A robot that is always exactly where its control wants it: for dry runs and tests, without a
/// simulation. Its time passes in [`KinematicArm::advance`].
#[derive(Debug)]
pub struct KinematicArm {
    control: CartesianControl,
    wanted_closing: f64,
    closing: f64,
}

impl KinematicArm {
    /// An arm where `control` has it, with open fingers.
    pub fn new(control: CartesianControl) -> Self {
        Self { control, wanted_closing: 0.0, closing: 0.0 }
    }

    /// Lets `seconds` pass.
    ///
    /// # Errors
    /// As [`CartesianControl::tick`], and the arm stands still.
    pub fn advance(&mut self, seconds: f64) -> Result<(), ControlError> {
        let moved = self.control.tick(seconds);
        self.unless_failed(moved)?;
        let most = seconds / CLOSING_TIME;
        self.closing += (self.wanted_closing - self.closing).clamp(-most, most);
        Ok(())
    }

    /// Stops arm and fingers where something failed.
    fn unless_failed(&mut self, outcome: Result<(), ControlError>) -> Result<(), ControlError> {
        if outcome.is_err() {
            self.stop()?;
        }
        outcome
    }

    /// What turns its commands into joint positions.
    pub fn control(&self) -> &CartesianControl {
        &self.control
    }
}

impl Robot for KinematicArm {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        Ok(RobotState {
            joints: self.control.joints().to_vec(),
            tip: self.control.tip(),
            closing: self.closing,
        })
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        let checked = command.check();
        let sent = checked.and_then(|()| self.control.command(command.twist));
        self.unless_failed(sent)?;
        self.wanted_closing = command.closing;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.control.stop();
        self.wanted_closing = self.closing;
        Ok(())
    }
}

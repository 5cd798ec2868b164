//! Watchdog that stops a robot without recent commands.

use std::time::Duration;

use crate::error::ControlError;
use crate::robot::{ArmCommand, Robot, RobotState};

/// Wrapper that stops a robot if a command is rejected, on drop, and, if it is polled, once no
/// command has arrived within the time-out.
///
/// `clock` defines time. For a real robot use `let start = Instant::now(); move ||
/// start.elapsed()`; for a simulated one, the simulation's time. A thread, or the loop that reads
/// the camera, must call [`Watchdog::stop_if_timed_out`] or [`Robot::state`], which includes it,
/// more often than the time-out.
pub struct Watchdog<R: Robot, C: Fn() -> Duration> {
    robot: R,
    clock: C,
    timeout: Duration,
    activity: Activity,
}

/// State of the robot, as far as the watchdog knows.
enum Activity {
    /// Stopped, with no command since.
    Still,
    /// Moving by a command that was sent at this time of the clock.
    Commanded(Duration),
    /// Possibly moving: the last attempt to stop it failed.
    Unstopped,
}

/// Default time after which a robot without a new command is stopped. It equals the default
/// [`TwistControlSettings::lookahead_s`](crate::TwistControlSettings::lookahead_s), which commands
/// are checked for.
const TIMEOUT: Duration = Duration::from_millis(200);

impl<R: Robot, C: Fn() -> Duration> Watchdog<R, C> {
    /// Wraps `robot`; the first call of [`Watchdog::stop_if_timed_out`] or [`Robot::state`] 200 ms
    /// or more after the last command stops it.
    pub fn new(robot: R, clock: C) -> Self {
        Self::with_timeout(robot, clock, TIMEOUT)
    }

    /// Wraps `robot`; the first call of [`Watchdog::stop_if_timed_out`] or [`Robot::state`]
    /// `timeout` or more after the last command stops it.
    pub fn with_timeout(robot: R, clock: C, timeout: Duration) -> Self {
        Self { robot, clock, timeout, activity: Activity::Still }
    }

    /// Stops the robot if the last command is at least as old as the time-out, if the clock went
    /// back since, or if an earlier stop failed. Returns `true` if it stopped the robot.
    ///
    /// # Errors
    /// [`ControlError::NotStopped`]; the next call tries again.
    pub fn stop_if_timed_out(&mut self) -> Result<bool, ControlError> {
        let cause = match self.activity {
            Activity::Still => return Ok(false),
            Activity::Commanded(commanded) => match (self.clock)().checked_sub(commanded) {
                Some(age) if age < self.timeout => return Ok(false),
                Some(age) => format!("no command came for {} ms", age.as_millis()),
                None => "the clock went back".to_owned(),
            },
            Activity::Unstopped => "an earlier stop failed".to_owned(),
        };
        self.halt(|| cause)?;
        Ok(true)
    }

    /// Returns the wrapped robot.
    pub fn robot(&self) -> &R {
        &self.robot
    }

    /// Returns the wrapped robot, for instance to advance its time.
    pub fn robot_mut(&mut self) -> &mut R {
        &mut self.robot
    }

    fn halt(&mut self, cause: impl FnOnce() -> String) -> Result<(), ControlError> {
        let stopped = self.robot.stop();
        self.activity = match stopped {
            Ok(()) => Activity::Still,
            Err(_) => Activity::Unstopped,
        };
        stopped
            .map_err(|source| ControlError::NotStopped { cause: cause(), source: Box::new(source) })
    }
}

impl<R: Robot, C: Fn() -> Duration> Robot for Watchdog<R, C> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.stop_if_timed_out()?;
        self.robot.state()
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        // before the command, which would make an overdue robot look freshly commanded
        self.stop_if_timed_out()?;
        let checked = command.check();
        // before the command is sent: a driver that panics or blocks may have sent it
        self.activity = Activity::Commanded((self.clock)());
        let sent = checked.and_then(|()| self.robot.command(command));
        if let Err(refused) = sent {
            self.halt(|| refused.to_string())?;
            return Err(refused);
        }
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.halt(|| "a stop was requested".to_owned())
    }
}

impl<R: Robot, C: Fn() -> Duration> Drop for Watchdog<R, C> {
    /// Stops the robot.
    fn drop(&mut self) {
        // a failure cannot be reported from here
        let _ = self.robot.stop();
    }
}

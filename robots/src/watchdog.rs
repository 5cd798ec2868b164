//! Stops a robot that nobody commands any more.

use std::time::Duration;

use crate::error::ControlError;
use crate::robot::{Command, Robot, RobotState};

/// A robot that stops where no command comes for a while, where a command is refused, and when it
/// is dropped.
///
/// Time is what `clock` says. For a real robot that is `let start = Instant::now(); move ||
/// start.elapsed()`; for a simulated one, the simulation's time. Somebody must call
/// [`Watchdog::check`], or [`Robot::state`], which calls it, more often than the time-out: a
/// thread, or the loop that reads the camera.
pub struct Watchdog<R: Robot, C: Fn() -> Duration> {
    robot: R,
    clock: C,
    timeout: Duration,
    activity: Activity,
}

/// What the robot does, as far as the watchdog knows.
enum Activity {
    /// It stands still.
    Still,
    /// It moves as it was told at that time.
    Commanded(Duration),
    /// It was told to stop and did not.
    Unstopped,
}

/// How long a robot goes on without a command.
const TIMEOUT: Duration = Duration::from_millis(200);

impl<R: Robot, C: Fn() -> Duration> Watchdog<R, C> {
    /// Watches over `robot`, which stops 200 ms after its last command.
    pub fn new(robot: R, clock: C) -> Self {
        Self::with_timeout(robot, clock, TIMEOUT)
    }

    /// Watches over `robot`, which stops `timeout` after its last command.
    pub fn with_timeout(robot: R, clock: C, timeout: Duration) -> Self {
        Self { robot, clock, timeout, activity: Activity::Still }
    }

    /// Stops the robot if the last command is as old as the time-out, or seems to lie in the future
    /// because the clock went back, and says whether it did.
    ///
    /// # Errors
    /// [`ControlError::NotStopped`]; the next call tries again.
    pub fn check(&mut self) -> Result<bool, ControlError> {
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

    /// The robot.
    pub fn robot(&self) -> &R {
        &self.robot
    }

    /// The robot, for instance to let its time pass.
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
        self.check()?;
        self.robot.state()
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        // a stop that is due comes first
        self.check()?;
        let sent = command.check().and_then(|()| self.robot.command(command));
        if let Err(refused) = sent {
            self.halt(|| refused.to_string())?;
            return Err(refused);
        }
        self.activity = Activity::Commanded((self.clock)());
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.halt(|| "the robot was told to stop".to_owned())
    }
}

impl<R: Robot, C: Fn() -> Duration> Drop for Watchdog<R, C> {
    /// Stops the robot; nobody is left who could be told of a failure.
    fn drop(&mut self) {
        let _ = self.robot.stop();
    }
}

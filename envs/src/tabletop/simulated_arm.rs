//! The arm of an environment behind the interface of a real one.

use std::collections::VecDeque;
use std::sync::Arc;

use robots::{Command, ControlError, Robot, RobotState};
use symmetry::D2;

use crate::control::Control;
use crate::drive::{Drive, ServoDrive, control_seconds};
use crate::error::{EnvError, require};
use crate::scene::Scene;
use crate::task::{Placement, StepReward};

use super::TableTop;

/// Longest latency (seconds).
const LONGEST: f64 = 1.0;

/// The arm of a [`TableTop`] as a [`Robot`]: twists move it, and its state is what its joints say.
/// Time passes in [`SimulatedArm::advance`].
///
/// Commands and stops take effect after a latency. An arm that stopped by itself, because it could
/// not follow, says why in the next call.
pub struct SimulatedArm {
    table: TableTop,
    /// Control steps from an order to its effect.
    delay: usize,
    steps: usize,
    /// Orders on their way, and the step in which each takes effect.
    sent: VecDeque<(usize, Order)>,
    fault: Option<ControlError>,
}

#[derive(Clone, Copy, Debug)]
enum Order {
    Move(Command),
    Stop,
}

impl SimulatedArm {
    /// The arm of `scene`, whose commands take effect after `latency` (seconds, rounded to control
    /// steps of 12.5 ms). It stands nowhere until [`SimulatedArm::start`].
    ///
    /// # Errors
    /// [`EnvError::Setting`] for a latency that is not in 0 to 1 s, and for an embodiment whose
    /// hand a weld pulls.
    pub fn new(scene: Arc<Scene>, latency: f64) -> Result<Self, EnvError> {
        let in_range = (0.0..=LONGEST).contains(&latency);
        require(in_range, "latency", &latency, "0 to 1 s")?;
        let (embodiment, drive) = (scene.embodiment, scene.embodiment.carrier().drive()?);
        let driven = matches!(drive, Drive::Servos(_));
        let expected = "an arm that servos move, as kinova_gen3";
        require(driven, "embodiment", &embodiment, expected)?;
        let table = TableTop::new(scene, Control::default())?;
        let delay = (latency / control_seconds(&table.data)).round() as usize;
        Ok(Self { table, delay, steps: 0, sent: VecDeque::new(), fault: None })
    }

    /// Puts the arm at the start of an episode of the variant `element`, at rest; `placement` is
    /// in the canonical frame.
    ///
    /// # Errors
    /// As [`TableTop::reset_to`].
    pub fn start(&mut self, element: D2, placement: Placement) -> Result<(), EnvError> {
        self.sent.clear();
        self.fault = None;
        self.table.reset_to(element, placement)
    }

    /// Lets a control step of 12.5 ms pass, and says how the task stands after it.
    ///
    /// # Errors
    /// [`EnvError::NotReset`]; a diverged simulation, which ends the episode.
    pub fn advance(&mut self) -> Result<StepReward, EnvError> {
        self.deliver();
        self.steps += 1;
        // taken out, so that nothing goes on from a simulation that failed
        let mut episode = self.table.episode.take().ok_or(EnvError::NotReset)?;
        let drive = episode.drive.as_mut().ok_or(EnvError::NotReset)?;
        let (finger, stopped) = drive.proceed(&mut self.table.data)?;
        self.fault = stopped.or(self.fault.take());
        let now = self.table.pass(&mut episode, finger)?;
        self.table.episode = Some(episode);
        Ok(now)
    }

    /// The environment, to be looked at.
    pub fn table(&self) -> &TableTop {
        &self.table
    }

    fn drive(&mut self) -> Result<&mut ServoDrive, ControlError> {
        let episode = self.table.episode.as_mut();
        let drive = episode.and_then(|episode| episode.drive.as_mut());
        drive.ok_or_else(not_started)
    }

    fn send(&mut self, order: Order) {
        self.sent.push_back((self.steps + self.delay, order));
        if self.delay == 0 {
            self.deliver();
        }
    }

    /// Why the arm stopped by itself since somebody asked last.
    fn check(&mut self) -> Result<(), ControlError> {
        self.fault.take().map_or(Ok(()), Err)
    }

    /// Lets the orders take effect that have come.
    fn deliver(&mut self) {
        while let Some((_, order)) = self.sent.pop_front_if(|(due, _)| *due <= self.steps) {
            let done = self.drive().and_then(|drive| match order {
                Order::Move(command) => drive.command(&command),
                Order::Stop => {
                    drive.stop();
                    Ok(())
                }
            });
            self.fault = done.err().or(self.fault.take());
        }
    }
}

impl Robot for SimulatedArm {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        self.check()?;
        let episode = self.table.episode.as_ref();
        let drive = episode.and_then(|episode| episode.drive.as_ref());
        let drive = drive.ok_or_else(not_started)?;
        Ok(drive.state(&self.table.data))
    }

    fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        let checked = command.check().and_then(|()| self.drive().map(|_| ()));
        if let Err(refused) = checked {
            self.stop()?;
            return Err(refused);
        }
        self.send(Order::Move(*command));
        self.check()
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.send(Order::Stop);
        Ok(())
    }
}

fn not_started() -> ControlError {
    ControlError::Driver { source: Box::new(EnvError::NotReset) }
}

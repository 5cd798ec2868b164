//! Simulated robot arm behind the interface of real arms, [`Robot`].

use std::collections::VecDeque;
use std::sync::Arc;

use robots::{ArmCommand, ControlError, Robot, RobotState};
use symmetry::D2;

use crate::actuation::{HandActuation, ServoArmController, control_step_seconds};
use crate::control::ControlSettings;
use crate::error::{EnvError, require};
use crate::scene::Scene;
use crate::task::{Placement, StepReward};

use super::TableTop;

/// Largest latency of commands to a simulated arm (seconds).
const MAX_LATENCY: f64 = 1.0;

/// Arm of a [`TableTop`] as a [`Robot`]: twists move it, and its state is computed from its joints.
/// Time passes in [`SimulatedArm::advance`].
///
/// Commands and stops take effect after a latency. If the arm stopped by itself because it could
/// not follow, the next call returns the reason.
pub struct SimulatedArm {
    table: TableTop,
    /// Number of control steps between an order (command or stop) and its effect.
    delay: usize,
    steps: usize,
    /// Pending orders (commands and stops), each with the control step in which it takes effect.
    sent: VecDeque<(usize, Order)>,
    fault: Option<ControlError>,
}

#[derive(Clone, Copy, Debug)]
enum Order {
    Move(ArmCommand),
    Stop,
}

impl SimulatedArm {
    /// Creates the arm of `scene`, whose commands take effect after `latency` (seconds, rounded to
    /// control steps of 12.5 ms). Call [`SimulatedArm::start_episode`] next.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`] for a latency outside 0 to 1 s, and for an embodiment without
    /// servos.
    pub fn new(scene: Arc<Scene>, latency: f64) -> Result<Self, EnvError> {
        let in_range = (0.0..=MAX_LATENCY).contains(&latency);
        require(in_range, "latency", &latency, "0 to 1 s")?;
        let (embodiment, actuation) = (scene.embodiment, scene.embodiment.spec().actuation()?);
        let driven = matches!(actuation, HandActuation::Servos(_));
        let expected = "an arm with servos, for instance kinova_gen3";
        require(driven, "embodiment", &embodiment, expected)?;
        let table = TableTop::new(scene, ControlSettings::default())?;
        let delay = (latency / control_step_seconds(&table.data)).round() as usize;
        Ok(Self { table, delay, steps: 0, sent: VecDeque::new(), fault: None })
    }

    /// Places the arm at rest at the start of an episode of the variant `element`; `placement` is
    /// in the canonical frame.
    ///
    /// # Errors
    /// Errors of [`TableTop::reset_to`].
    pub fn start_episode(&mut self, element: D2, placement: Placement) -> Result<(), EnvError> {
        self.sent.clear();
        self.fault = None;
        self.table.reset_to(element, placement)
    }

    /// Executes the commands that are due, simulates one control step of 12.5 ms, and returns its
    /// reward and success.
    ///
    /// # Errors
    /// [`EnvError::NotReset`]; [`EnvError::Simulation`] if the simulation diverges, which ends the
    /// episode.
    pub fn advance(&mut self) -> Result<StepReward, EnvError> {
        self.deliver();
        self.steps += 1;
        // taken out, so that a failed simulation leaves no episode to continue
        let mut episode = self.table.episode.take().ok_or(EnvError::NotReset)?;
        let controller = episode.controller.as_mut().ok_or(EnvError::NotReset)?;
        let (finger, stopped) = controller.step_command(&mut self.table.data)?;
        episode.target = controller.reference_position();
        self.fault = stopped.or(self.fault.take());
        let now = self.table.pass(&mut episode, finger)?;
        self.table.episode = Some(episode);
        Ok(now)
    }

    /// Returns the environment in which the arm is simulated, for reading.
    pub fn environment(&self) -> &TableTop {
        &self.table
    }

    fn controller(&mut self) -> Result<&mut ServoArmController, ControlError> {
        let episode = self.table.episode.as_mut();
        let controller = episode.and_then(|episode| episode.controller.as_mut());
        controller.ok_or_else(not_started)
    }

    fn send(&mut self, order: Order) {
        self.sent.push_back((self.steps + self.delay, order));
        // without latency an order takes effect before the next step
        if self.delay == 0 {
            self.deliver();
        }
    }

    /// Returns the reason for which the arm stopped since the last call, if it did.
    fn check(&mut self) -> Result<(), ControlError> {
        self.fault.take().map_or(Ok(()), Err)
    }

    /// Executes the orders (commands and stops) that are due in the present control step.
    fn deliver(&mut self) {
        while let Some((_, order)) = self.sent.pop_front_if(|(due, _)| *due <= self.steps) {
            let done = self.controller().and_then(|controller| match order {
                Order::Move(command) => controller.command(&command),
                Order::Stop => {
                    controller.stop();
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
        let controller = episode.and_then(|episode| episode.controller.as_ref());
        let controller = controller.ok_or_else(not_started)?;
        Ok(controller.state(&self.table.data))
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        let checked = command.check().and_then(|()| self.controller().map(|_| ()));
        if let Err(refused) = checked {
            // an invalid command stops the arm instead of leaving the last one in force
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

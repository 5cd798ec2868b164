//! Controller that turns a policy's decisions into twists, at 40 Hz.

use std::time::{Duration, Instant};

use envs::embodiments::Arm;
use envs::{ACTION_DIM, Control, Layout};
use glam::{DQuat, DVec3};
use robots::{Command, ControlError, Pose, RobotState, Twist, TwistLimits};

use crate::DeployError;

use super::observer::Observer;
use super::rig::Rig;

/// Time between commands: a Kinova Gen3 accepts them at 40 Hz.
pub(super) const TICK: Duration = Duration::from_millis(25);
/// Proportional gain (1/s) from the distance to the target to the speed of the hand.
const RATE: f64 = 10.0;
/// Fraction of [`RATE`] at which the hand's orientation is restored. Objects that the hand pushes
/// turn it.
const TURNING: f64 = 0.2;
/// Maximum distance from the hand to the target (metres): the target waits for a hand that is slow
/// or blocked. Larger than that of the scripted experts, because commands take effect late.
const LEAD: f64 = 0.05;

/// Controller of an arm's hand for a policy. As in training, the hand follows a target, and each
/// decision moves the target.
///
/// Commands follow from a reference: the position that earlier commands should have led to. The
/// measured position corrects the reference only if it is further away than [`LEAD`], so an arm
/// with delayed commands does not oscillate.
#[derive(Clone, Debug)]
pub(super) struct ActionController {
    limits: TwistLimits,
    /// Orientation that the hand keeps.
    rotation: DQuat,
    /// Time in which the fingers close (seconds).
    closing_time: f64,
    /// Distance by which a full action moves the target in a tick (metres).
    displacement: f64,
    /// Number of ticks per decision.
    ticks: usize,
    target: DVec3,
    /// Position of the hand that the commands so far should have led to (metres).
    reference: DVec3,
    /// Current twist of the reference.
    twist: Twist,
    closing: f64,
    refused: usize,
    /// Time spent on the commands of the last decision, waiting excluded.
    spent: Duration,
}

impl ActionController {
    /// Creates a controller of an arm that rests at `start`, for a policy trained with `control`.
    pub fn new(arm: &Arm, control: &Control, start: &RobotState) -> Self {
        let seconds = control.decision_seconds();
        let ticks = (seconds / TICK.as_secs_f64()).round().max(1.0);
        let settings = arm.settings();
        Self {
            limits: settings.control.limits,
            rotation: arm.chain().tip(&settings.ready).rotation,
            // a hand without fingers never closes
            closing_time: arm.closing_time().unwrap_or(f64::INFINITY),
            displacement: control.displacement / ticks,
            ticks: ticks as usize,
            target: start.tip.position,
            reference: start.tip.position,
            twist: Twist::ZERO,
            closing: start.closing,
            refused: 0,
            spent: Duration::ZERO,
        }
    }

    /// Returns `true` if a decision lasts a whole number of ticks.
    pub fn is_whole_ticks(control: &Control) -> bool {
        let ticks = control.decision_seconds() / TICK.as_secs_f64();
        ticks >= 1.0 && ticks.fract() == 0.0
    }

    /// Returns the number of commands that the arm refused because it could not follow them.
    pub fn refused(&self) -> usize {
        self.refused
    }

    /// Returns the time that computing and sending the commands of the last decision took.
    pub fn spent(&self) -> Duration {
        self.spent
    }

    /// Executes `action` for one decision and records the arm's states in `observer`. Components
    /// are clipped to `[-1, 1]`.
    ///
    /// # Errors
    /// [`DeployError::Robot`], [`DeployError::Rig`]; the arm may be moving.
    pub fn decide(
        &mut self,
        rig: &mut dyn Rig,
        observer: &mut Observer,
        action: [f32; ACTION_DIM],
    ) -> Result<(), DeployError> {
        let [x, y, z, finger] = action.map(|value| f64::from(value.clamp(-1.0, 1.0)));
        self.spent = Duration::ZERO;
        for _ in 0..self.ticks {
            let started = Instant::now();
            // a robot may report a refused command when its state is read: count it, and read again
            let state = match rig.state() {
                Err(ControlError::CannotFollow { .. }) => {
                    self.refused += 1;
                    rig.state()?
                }
                state => state?,
            };
            self.move_target(DVec3::new(x, y, z), finger, &state);
            let command = self.command(&state);
            self.twist = self.limits.ramp(self.twist, command.twist, TICK.as_secs_f64());
            self.reference += TICK.as_secs_f64() * self.twist.linear;
            match rig.command(&command) {
                Err(ControlError::CannotFollow { .. }) => self.refused += 1,
                sent => sent?,
            }
            self.spent += started.elapsed();
            rig.wait(TICK).map_err(|source| DeployError::Rig { source })?;
            self.record(rig, observer)?;
        }
        Ok(())
    }

    /// Records the arm's state in `observer`.
    fn record(&mut self, rig: &mut dyn Rig, observer: &mut Observer) -> Result<(), DeployError> {
        match rig.state() {
            Ok(state) => observer.record(rig.now(), state),
            Err(ControlError::CannotFollow { .. }) => self.refused += 1,
            Err(other) => return Err(other.into()),
        }
        Ok(())
    }

    fn move_target(&mut self, way: DVec3, finger: f64, state: &RobotState) {
        let [low, high] = Layout::Symmetric.target_bounds();
        let wanted = (self.target + self.displacement * way).clamp(low, high);
        let hand = state.tip.position;
        // both stay close to the measured position, or the arm would catch up in one jump
        let within_lead = |place: DVec3| hand + (place - hand).clamp_length_max(LEAD);
        (self.target, self.reference) = (within_lead(wanted), within_lead(self.reference));
        let closing = self.closing + finger * TICK.as_secs_f64() / self.closing_time;
        self.closing = closing.clamp(0.0, 1.0);
    }

    fn command(&self, state: &RobotState) -> Command {
        let target = Pose { position: self.target, rotation: self.rotation };
        let [_, turn] = state.tip.displacement_to(&target);
        // the position follows the reference, the orientation follows the measured pose
        let way = [self.target - self.reference, TURNING * turn];
        Command { twist: self.limits.towards(way, RATE), closing: self.closing }
    }
}

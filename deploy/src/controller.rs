//! Controller that turns a policy's decisions into velocities (twists) of the arm's hand, at 40 Hz.

use std::time::{Duration, Instant};

use envs::embodiments::Arm;
use envs::{ACTION_DIM, ControlSettings, Layout};
use glam::{DQuat, DVec3};
use robots::{
    ArmCommand, ControlError, OrientationConstraint, Pose, RobotState, Twist, TwistLimits,
};

use crate::DeployError;

use super::observer::RigPerception;
use super::rig::Rig;

/// Time between commands to the arm: a Kinova Gen3 accepts them at 40 Hz.
pub(super) const COMMAND_PERIOD: Duration = Duration::from_millis(25);
/// Proportional gain (1/s) from the distance to the target to the speed of the hand.
const RATE: f64 = 10.0;
/// Gain that restores the hand's orientation, as a fraction of [`RATE`]. Objects that the hand
/// pushes turn the hand.
const TURNING: f64 = 0.2;
/// Maximum distance from the hand to the target (metres): the target waits for a hand that is slow
/// or blocked. Larger than that of the scripted experts, because commands take effect late.
const LEAD: f64 = 0.05;

/// Controller that turns a policy's actions into commands to an arm's hand, at 40 Hz. As in
/// training, the hand follows a target, and each decision moves the target.
///
/// Commands follow from a reference: the position that earlier commands should have led to. The
/// measured position corrects the reference only if it is further away than [`LEAD`], so an arm
/// with delayed commands does not oscillate.
#[derive(Clone, Debug)]
pub(super) struct ActionController {
    limits: TwistLimits,
    /// Orientation that the hand keeps.
    rotation: DQuat,
    /// Constraint on the hand's orientation: the part of `rotation` that the controller keeps.
    orientation: OrientationConstraint,
    /// Time in which the fingers close (seconds).
    closing_time: f64,
    /// Distance by which a full action moves the target in a tick of 25 ms (metres).
    displacement: f64,
    /// Number of ticks per decision, with one command in each.
    ticks: usize,
    target: DVec3,
    /// Position of the hand that the commands so far should have led to (metres).
    reference: DVec3,
    /// Current twist (linear and angular velocity) of `reference`.
    twist: Twist,
    gripper_closure: f64,
    refused_commands: usize,
    /// Time spent on the commands of the last decision, waiting excluded.
    command_time: Duration,
}

impl ActionController {
    /// Creates a controller of an arm that rests at `start`, for a policy trained with `control`.
    pub fn new(arm: &Arm, control: &ControlSettings, start: &RobotState) -> Self {
        let seconds = control.decision_seconds();
        let ticks = (seconds / COMMAND_PERIOD.as_secs_f64()).round().max(1.0);
        let settings = arm.settings();
        Self {
            limits: settings.control.limits,
            rotation: arm.chain().tip_pose(&settings.ready_joint_positions).rotation,
            orientation: settings.control.orientation,
            // a hand without fingers never closes
            closing_time: arm.closing_seconds().unwrap_or(f64::INFINITY),
            displacement: control.displacement / ticks,
            ticks: ticks as usize,
            target: start.tip.position,
            reference: start.tip.position,
            twist: Twist::ZERO,
            gripper_closure: start.gripper_closure,
            refused_commands: 0,
            command_time: Duration::ZERO,
        }
    }

    /// Returns `true` if a decision lasts a whole number of command periods of 25 ms.
    pub fn supports_decision_duration(control: &ControlSettings) -> bool {
        let ticks = control.decision_seconds() / COMMAND_PERIOD.as_secs_f64();
        // the quotient of two decimal fractions is rounded
        ticks >= 0.5 && (ticks - ticks.round()).abs() < 1e-9
    }

    /// Returns the position (metres) that the hand follows.
    pub fn target_position(&self) -> DVec3 {
        self.target
    }

    /// Returns the number of commands that the arm refused because it could not follow them.
    pub fn num_refused_commands(&self) -> usize {
        self.refused_commands
    }

    /// Returns the time that computing and sending the commands of the last decision took.
    pub fn last_decision_send_duration(&self) -> Duration {
        self.command_time
    }

    /// Executes `action` for one decision and records the arm's states in `observer`. Components
    /// are clipped to `[-1, 1]`.
    ///
    /// # Errors
    /// [`DeployError::Robot`], [`DeployError::Rig`]; the arm may be moving.
    pub fn execute_action(
        &mut self,
        rig: &mut dyn Rig,
        observer: &mut RigPerception,
        action: [f32; ACTION_DIM],
    ) -> Result<(), DeployError> {
        let [x, y, z, finger] = action.map(|value| f64::from(value.clamp(-1.0, 1.0)));
        self.command_time = Duration::ZERO;
        for _ in 0..self.ticks {
            let started = Instant::now();
            // a robot may report a refused command when its state is read: count it, and read again
            let state = match rig.state() {
                Err(ControlError::CannotFollow { .. }) => {
                    self.take_back_command();
                    rig.state()?
                }
                state => state?,
            };
            self.move_target(DVec3::new(x, y, z), finger, &state);
            let command = self.command(&state);
            self.twist =
                self.limits.ramp_twist(self.twist, command.twist, COMMAND_PERIOD.as_secs_f64());
            self.reference += COMMAND_PERIOD.as_secs_f64() * self.twist.linear;
            match rig.command(&command) {
                Err(ControlError::CannotFollow { .. }) => self.take_back_command(),
                sent => sent?,
            }
            self.command_time += started.elapsed();
            rig.wait(COMMAND_PERIOD).map_err(|source| DeployError::Rig { source })?;
            self.record(rig, observer)?;
        }
        Ok(())
    }

    /// Records the arm's state in `observer`.
    fn record(
        &mut self,
        rig: &mut dyn Rig,
        observer: &mut RigPerception,
    ) -> Result<(), DeployError> {
        match rig.state() {
            Ok(state) => observer.record_state(rig.now(), state),
            Err(ControlError::CannotFollow { .. }) => self.take_back_command(),
            Err(other) => return Err(other.into()),
        }
        Ok(())
    }

    /// Counts a refused command and moves the reference back: an arm that refuses a command stands
    /// still.
    fn take_back_command(&mut self) {
        self.refused_commands += 1;
        self.reference -= COMMAND_PERIOD.as_secs_f64() * self.twist.linear;
        self.twist = Twist::ZERO;
    }

    fn move_target(&mut self, way: DVec3, finger: f64, state: &RobotState) {
        let [low, high] = Layout::Symmetric.hand_target_bounds();
        let wanted = (self.target + self.displacement * way).clamp(low, high);
        let hand = state.tip.position;
        // both stay close to the measured position, or the arm would catch up in one jump
        let within_lead = |place: DVec3| hand + (place - hand).clamp_length_max(LEAD);
        (self.target, self.reference) = (within_lead(wanted), within_lead(self.reference));
        let closing =
            self.gripper_closure + finger * COMMAND_PERIOD.as_secs_f64() / self.closing_time;
        self.gripper_closure = closing.clamp(0.0, 1.0);
    }

    fn command(&self, state: &RobotState) -> ArmCommand {
        let target = Pose { position: self.target, rotation: self.rotation };
        let turn = self.orientation.pose_error(&state.tip, &target).angular;
        // the position follows the reference, the orientation follows the measured pose
        let way = [self.target - self.reference, TURNING * turn];
        ArmCommand {
            twist: self.limits.twist_towards(way, RATE),
            gripper_closure: self.gripper_closure,
        }
    }
}

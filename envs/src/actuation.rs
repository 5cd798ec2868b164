//! Actuation of the hand: the mechanisms by which a decision moves the gripper.

use std::sync::Arc;

use glam::{DQuat, DVec3};
use mujoco::{Data, Model};
use robots::{
    ArmCommand, Capsule, ControlError, JointServoSettings, OrientationConstraint, Pose,
    RobotDescription, RobotState, Twist, TwistController,
};

use crate::control::PHYSICS_STEPS_PER_CONTROL_STEP;
use crate::error::EnvError;

/// Joint positions by joint name (metres or radians).
pub type NamedJointPositions = Vec<(String, f64)>;

/// Mechanism by which the hand follows its target; actions move that target.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum HandActuation {
    /// Weld that pulls the body `hand` to the mocap body `hand_target`. The model's only two
    /// actuators, `right_finger` and `left_finger`, get the finger action and its negative.
    Weld,
    /// Servo motors in the joints, as in a real arm; inverse kinematics gives their targets.
    Servos(Box<ServoArmController>),
}

/// Settings of a [`ServoArmController`] that stay constant while it runs.
#[derive(Debug, PartialEq)]
pub(crate) struct ServoSettings {
    pub arm: RobotDescription,
    pub servo: JointServoSettings,
    /// Orientation in which the hand is held.
    pub hand_rotation: DQuat,
    /// Drive of the gripper's fingers; `None` for fingers that do not move.
    pub finger: Option<FingerDrive>,
    /// Largest distance of the hand's target from the hand (metres).
    pub max_target_lead: f64,
    /// Maximum speeds and accelerations of the hand.
    pub limits: robots::TwistLimits,
    /// Constraint on the orientation of the hand: the part that the hand keeps.
    pub orientation: OrientationConstraint,
}

/// Joint that drives a gripper's fingers: its index, positions and maximum speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FingerDrive {
    /// Index of the finger joint among the arm's free joints.
    pub dof: usize,
    /// Positions of the finger joint with open and with closed fingers (metres or radians).
    pub positions: [f64; 2],
    /// Maximum speed of the finger joint (metres or radians per second).
    pub max_speed: f64,
}

impl FingerDrive {
    /// Returns the distance between the open and the closed position of the finger joint (metres or
    /// radians).
    pub fn travel(&self) -> f64 {
        (self.positions[1] - self.positions[0]).abs()
    }

    /// Returns the finger joint's position at a closure from 0 (open) to 1 (closed).
    pub fn position_at_closure(&self, closure: f64) -> f64 {
        let [open, closed] = self.positions;
        open + closure * (closed - open)
    }

    /// Returns the closure, from 0 (open) to 1 (closed), with the finger joint at `position`.
    fn closure(&self, position: f64) -> f64 {
        let [open, closed] = self.positions;
        ((position - open) / (closed - open)).clamp(0.0, 1.0)
    }
}

/// Controller of an arm whose servos follow inverse kinematics.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoArmController {
    servos: Arc<ServoSettings>,
    control: TwistController,
    /// Addresses in `qpos` of the arm's free joints.
    addresses: Vec<usize>,
    /// Commanded finger position: 0 is open, 1 is closed.
    gripper_closure: f64,
    /// Last command of [`ServoArmController::command`], which stays in force.
    commanded: ArmCommand,
}

/// Largest angle (radians) between the hand's orientation and the commanded one, beyond which the
/// control waits for the hand.
const MAX_TURN_ERROR: f64 = 0.1;
/// Rate (1/s) of the final, exponential approach of the hand to its target.
const APPROACH_RATE: f64 = 10.0;

impl ServoArmController {
    pub(crate) fn new(servos: ServoSettings, control: TwistController) -> Self {
        Self {
            servos: Arc::new(servos),
            control,
            addresses: Vec::new(),
            gripper_closure: 0.0,
            commanded: ArmCommand::default(),
        }
    }

    /// Looks up the arm's joints in `model` and resets the controller to rest at the positions
    /// `rest`, or 0 for joints that are not in it.
    pub(crate) fn start(
        &mut self,
        model: &Model,
        rest: &NamedJointPositions,
    ) -> Result<(), EnvError> {
        let joints = self.servos.arm.free_joints();
        let address = |(joint, _): (&robots::Joint, _)| {
            Ok(model.joint_qpos_address(model.joint(&joint.name)?))
        };
        self.addresses = joints.map(address).collect::<Result<_, EnvError>>()?;
        let at = |joint: &robots::ChainJoint| {
            let named = rest.iter().find(|(name, _)| *name == joint.name);
            named.map_or(0.0, |(_, position)| *position)
        };
        let configuration: Vec<f64> = self.control.chain().joints().iter().map(at).collect();
        Ok(self.control.restart(&configuration)?)
    }

    /// Returns the target `wanted`, moved so that it is at most `max_target_lead` from `hand`. The
    /// target of a slow or blocked arm thus cannot run away.
    pub(crate) fn within_lead(&self, wanted: DVec3, hand: DVec3) -> DVec3 {
        hand + (wanted - hand).clamp_length_max(self.servos.max_target_lead)
    }

    /// Sets the servo controls for one control step that moves the hand towards `target` (metres,
    /// world frame) and the fingers at the share `finger` of their maximum speed, from -1 (opens)
    /// to 1 (closes).
    pub(crate) fn advance(
        &mut self,
        data: &mut Data,
        target: DVec3,
        finger: f64,
    ) -> Result<(), EnvError> {
        let seconds = control_step_seconds(data);
        self.follow(target, seconds)?;
        self.close(finger, seconds);
        Ok(data.set_all_ctrl(&self.controls(&self.positions(data)))?)
    }

    /// Replaces the command that the controller follows.
    pub(crate) fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        self.control.command_twist(command.twist)?;
        self.commanded = *command;
        Ok(())
    }

    /// Stops hand and fingers at the controller's present targets.
    pub(crate) fn stop(&mut self) {
        self.control.stop();
        self.commanded = ArmCommand { twist: Twist::ZERO, gripper_closure: self.gripper_closure };
    }

    /// Returns the position of the hand that the servos are told to hold (metres, world frame).
    pub(crate) fn reference_position(&self) -> DVec3 {
        self.control.tip_pose().position
    }

    /// Sets the servo controls for one control step of the command that the controller follows.
    /// Returns the finger speed in `[-1, 1]`, and the error that stopped the arm, if any.
    pub(crate) fn step_command(
        &mut self,
        data: &mut Data,
    ) -> Result<(f64, Option<ControlError>), EnvError> {
        let seconds = control_step_seconds(data);
        let stopped = self.advance_command(data, seconds).err();
        // a command that cannot be followed must not be tried again in the next step
        if stopped.is_some() {
            self.stop();
        }
        let way = self.commanded.gripper_closure - self.gripper_closure;
        let finger = self.servos.finger.map_or(0.0, |drive| {
            (way * drive.travel() / (drive.max_speed * seconds)).clamp(-1.0, 1.0)
        });
        self.close(finger, seconds);
        data.set_all_ctrl(&self.controls(&self.positions(data)))?;
        Ok((finger, stopped))
    }

    /// Follows the present command for `seconds`. The control waits while something blocks the
    /// hand, because the servos would push ever harder.
    fn advance_command(&mut self, data: &Data, seconds: f64) -> Result<(), ControlError> {
        let twist = self.commanded.twist;
        let (tip, reference) = (self.state(data).tip, self.control.tip_pose());
        let Twist { linear: ahead, angular: turned } =
            self.servos.orientation.pose_error(&tip, &reference);
        let held_back =
            ahead.length() > self.servos.max_target_lead && ahead.dot(twist.linear) > 0.0;
        let held_turned = turned.length() > MAX_TURN_ERROR && turned.dot(twist.angular) > 0.0;
        // a command that moves back towards the hand is not held up
        if held_back || held_turned {
            self.control.stop();
            return Ok(());
        }
        self.control.command_twist(twist)?;
        self.control.tick(seconds)
    }

    /// Returns the robot's state in `data`, as its joint sensors would report it.
    pub(crate) fn state(&self, data: &Data) -> RobotState {
        let positions = self.positions(data);
        let chain = self.control.chain();
        let joints = chain.extract_configuration(&positions);
        let gripper_closure =
            self.servos.finger.map_or(0.0, |drive| drive.closure(positions[drive.dof]));
        RobotState { tip: chain.tip_pose(&joints), joints, gripper_closure }
    }

    /// Returns the capsules that enclose the arm (metres, world frame), always in the same order.
    pub(crate) fn capsules(&self, data: &Data) -> Vec<Capsule> {
        let capsules = self.servos.arm.enclosing_capsules(&self.positions(data));
        capsules.into_iter().map(|(_, capsule)| capsule).collect()
    }

    /// Returns the positions of the arm's free joints.
    fn positions(&self, data: &Data) -> Vec<f64> {
        self.addresses.iter().map(|&at| data.qpos()[at]).collect()
    }

    fn follow(&mut self, target: DVec3, seconds: f64) -> Result<(), EnvError> {
        let target = Pose { position: target, rotation: self.servos.hand_rotation };
        let Twist { linear, angular } =
            self.servos.orientation.pose_error(&self.control.tip_pose(), &target);
        let twist = self.servos.limits.twist_towards([linear, angular], APPROACH_RATE);
        let followed = self.control.command_twist(twist);
        match followed.and_then(|()| self.control.tick(seconds)) {
            // no error: the arm stops at the limit of its reach
            Err(ControlError::CannotFollow { .. }) => Ok(()),
            outcome => Ok(outcome?),
        }
    }

    fn close(&mut self, finger: f64, seconds: f64) {
        if let Some(drive) = self.servos.finger {
            let change = finger * seconds * drive.max_speed / drive.travel();
            let closing = self.gripper_closure + change;
            self.gripper_closure = closing.clamp(0.0, 1.0);
        }
    }

    /// Returns the controls of all servos: position and velocity targets of their joints, and the
    /// feed-forward that carries the arm's own weight at `positions`.
    fn controls(&self, positions: &[f64]) -> Vec<f64> {
        let ServoSettings { arm, servo, finger, .. } = &*self.servos;
        let forces = arm.gravity_compensation_forces(positions);
        // joints that are neither the arm's nor the fingers' rest
        let mut controls = arm.rest_positions();
        let velocities = self.control.joint_velocities();
        let targets = self.control.joint_positions().iter().zip(velocities);
        for (joint, (&position, &velocity)) in self.control.chain().joints().iter().zip(targets) {
            controls[joint.dof_index] = servo.control_signal(position, velocity);
        }
        if let Some(drive) = finger {
            controls[drive.dof] = drive.position_at_closure(self.gripper_closure);
        }
        for (dof, (_, motion)) in arm.free_joints().enumerate() {
            controls[dof] += servo.control_offset_for_force(motion, forces[dof]);
        }
        controls
    }
}

/// Returns the duration of a control step in seconds.
pub(crate) fn control_step_seconds(data: &Data) -> f64 {
    PHYSICS_STEPS_PER_CONTROL_STEP as f64 * data.model().timestep()
}

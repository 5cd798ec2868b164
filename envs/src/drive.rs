//! How a decision moves the hand.

use std::sync::Arc;

use glam::{DQuat, DVec3};
use mujoco::{Data, Model};
use robots::{
    CartesianControl, Command, ControlError, Description, Motion, Pose, RobotState, Servo, Twist,
};

use crate::control::PHYSICS_STEPS;
use crate::error::EnvError;

/// Joints by name, with positions in metres or radians.
pub type Posture = Vec<(String, f64)>;

/// How the hand follows its target, which an action moves.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Drive {
    /// A weld pulls the body `hand` to the mocap body `hand_target`. Two actuators, `right_finger`
    /// and then `left_finger`, are told the finger action and its negative.
    Weld,
    /// Joints bring the hand there, as those of a real arm do.
    Servos(Box<ServoDrive>),
}

/// What an arm's drive does not change.
#[derive(Debug, PartialEq)]
pub(crate) struct Servos {
    pub arm: Description,
    pub servo: Servo,
    /// How the hand is turned.
    pub rotation: DQuat,
    /// Index of the finger joint among the arm's free joints.
    pub finger: Option<usize>,
    /// The furthest that the target may be ahead of the hand (metres).
    pub lead: f64,
    /// Limits of the hand's motion.
    pub limits: robots::TwistLimits,
}

/// An arm whose servos follow inverse kinematics, and where it is about to go.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoDrive {
    servos: Arc<Servos>,
    control: CartesianControl,
    /// Addresses in `qpos` of the arm's free joints.
    addresses: Vec<usize>,
    /// Where the fingers should be: 0 is open, 1 is closed.
    closing: f64,
    /// What was commanded.
    commanded: Command,
}

/// How far a hand may be turned from where its control has it (radians) while it turns further.
const TURNED: f64 = 0.1;
/// Rate (1/s) at which the last millimetres to the target are covered.
const RATE: f64 = 10.0;

impl ServoDrive {
    pub(crate) fn new(servos: Servos, control: CartesianControl) -> Self {
        Self {
            servos: Arc::new(servos),
            control,
            addresses: Vec::new(),
            closing: 0.0,
            commanded: Command::default(),
        }
    }

    /// Takes over the joints of `model`, at rest in `posture`.
    pub(crate) fn start(&mut self, model: &Model, posture: &Posture) -> Result<(), EnvError> {
        let joints = self.servos.arm.free_joints();
        let address = |(joint, _): (&robots::Joint, _)| {
            Ok(model.joint_qpos_address(model.joint(&joint.name)?))
        };
        self.addresses = joints.map(address).collect::<Result<_, EnvError>>()?;
        let at = |joint: &robots::ChainJoint| {
            let mut named = posture.iter().filter(|(name, _)| *name == joint.name);
            named.next().map_or(0.0, |(_, position)| *position)
        };
        let configuration: Vec<f64> = self.control.chain().joints().iter().map(at).collect();
        Ok(self.control.restart(&configuration)?)
    }

    /// Where the hand's target is when it should be at `wanted`: an arm that is slow, or that is
    /// held back, does not let its target run away.
    pub(crate) fn within_lead(&self, wanted: DVec3, hand: DVec3) -> DVec3 {
        hand + (wanted - hand).clamp_length_max(self.servos.lead)
    }

    /// Tells the servos of one control step: the hand goes towards `target` (metres, world), and
    /// the fingers close at the speed `finger` in `[-1, 1]`.
    pub(crate) fn advance(
        &mut self,
        data: &mut Data,
        target: DVec3,
        finger: f64,
    ) -> Result<(), EnvError> {
        let seconds = control_seconds(data);
        self.follow(target, seconds)?;
        self.close(finger, seconds);
        Ok(data.set_ctrl(&self.controls(&self.positions(data)))?)
    }

    /// Takes a command, which stays in force.
    pub(crate) fn command(&mut self, command: &Command) -> Result<(), ControlError> {
        self.control.command(command.twist)?;
        self.commanded = *command;
        Ok(())
    }

    /// Holds hand and fingers where they are.
    pub(crate) fn stop(&mut self) {
        self.control.stop();
        self.commanded = Command { twist: Twist::ZERO, closing: self.closing };
    }

    /// Tells the servos of one control step of what was commanded. Returns the speed of the
    /// fingers in `[-1, 1]`, and why the arm stopped by itself, if it did.
    pub(crate) fn proceed(
        &mut self,
        data: &mut Data,
    ) -> Result<(f64, Option<ControlError>), EnvError> {
        let seconds = control_seconds(data);
        let stopped = self.keep_on(data, seconds).err();
        if stopped.is_some() {
            self.stop();
        }
        let way = self.commanded.closing - self.closing;
        let finger = self
            .closing_speed()
            .map_or(0.0, |(speed, travel)| (way * travel / (speed * seconds)).clamp(-1.0, 1.0));
        self.close(finger, seconds);
        data.set_ctrl(&self.controls(&self.positions(data)))?;
        Ok((finger, stopped))
    }

    /// Moves on as commanded, unless something holds the hand back: the servos would push harder
    /// and harder.
    fn keep_on(&mut self, data: &Data, seconds: f64) -> Result<(), ControlError> {
        let twist = self.commanded.twist;
        let [ahead, turned] = self.state(data).tip.way_to(&self.control.tip());
        let held_back = ahead.length() > self.servos.lead && ahead.dot(twist.linear) > 0.0;
        let held_turned = turned.length() > TURNED && turned.dot(twist.angular) > 0.0;
        if held_back || held_turned {
            self.control.stop();
            return Ok(());
        }
        self.control.command(twist)?;
        self.control.tick(seconds)
    }

    /// Where the robot is in `data`, as its own sensors tell it.
    pub(crate) fn state(&self, data: &Data) -> RobotState {
        let positions = self.positions(data);
        let chain = self.control.chain();
        let joints = chain.configuration(&positions);
        let closing = self.finger().map_or(0.0, |(dof, motion)| {
            let [open, closed] = motion.range.unwrap_or([0.0, 1.0]);
            ((positions[dof] - open) / (closed - open)).clamp(0.0, 1.0)
        });
        RobotState { tip: chain.tip(&joints), joints, closing }
    }

    /// Positions of the arm's free joints.
    fn positions(&self, data: &Data) -> Vec<f64> {
        self.addresses.iter().map(|&at| data.qpos()[at]).collect()
    }

    /// The joint that closes the fingers, and its index among the free joints.
    fn finger(&self) -> Option<(usize, &Motion)> {
        let dof = self.servos.finger?;
        let (_, motion) = self.servos.arm.free_joints().nth(dof)?;
        Some((dof, motion))
    }

    /// Speed and travel of the joint that closes the fingers (metres or radians).
    fn closing_speed(&self) -> Option<(f64, f64)> {
        let (_, motion) = self.finger()?;
        let travel = motion.range.map_or(1.0, |[low, high]| high - low);
        Some((motion.speed, travel))
    }

    fn follow(&mut self, target: DVec3, seconds: f64) -> Result<(), EnvError> {
        let target = Pose { position: target, rotation: self.servos.rotation };
        let way = self.control.tip().way_to(&target);
        let twist = self.servos.limits.towards(way, RATE);
        let followed = self.control.command(twist);
        match followed.and_then(|()| self.control.tick(seconds)) {
            // the arm stands where its reach ends
            Err(ControlError::OutOfReach { .. }) => Ok(()),
            outcome => Ok(outcome?),
        }
    }

    fn close(&mut self, finger: f64, seconds: f64) {
        if let Some((speed, travel)) = self.closing_speed() {
            let closing = self.closing + finger * seconds * speed / travel;
            self.closing = closing.clamp(0.0, 1.0);
        }
    }

    /// Controls of all servos for joints that are at `positions`: where they should be, how fast
    /// they should move, and what holds the arm up.
    fn controls(&self, positions: &[f64]) -> Vec<f64> {
        let Servos { arm, servo, finger, .. } = &*self.servos;
        let forces = arm.holding_forces(positions);
        let mut controls = vec![0.0; arm.dofs()];
        let velocities = self.control.velocities();
        let targets = self.control.joints().iter().zip(velocities);
        for (joint, (&position, &velocity)) in self.control.chain().joints().iter().zip(targets) {
            controls[joint.dof] = servo.control(position, velocity);
        }
        for (dof, (_, motion)) in arm.free_joints().enumerate() {
            if *finger == Some(dof) {
                let [open, closed] = motion.range.unwrap_or([0.0, 1.0]);
                controls[dof] = open + self.closing * (closed - open);
            }
            controls[dof] += servo.feed_forward(motion, forces[dof]);
        }
        controls
    }
}

/// Seconds of a control step.
pub(crate) fn control_seconds(data: &Data) -> f64 {
    PHYSICS_STEPS as f64 * data.model().timestep()
}

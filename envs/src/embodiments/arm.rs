//! Arm of a URDF whose servos follow inverse kinematics.

use std::time::Duration;

use glam::DVec3;
use robots::{
    Capsule, Chain, IkSettings, JointServoSettings, LinkMjcfAddition, MjcfSettings, Pose,
    RobotDescription, RobotState, TwistControlSettings, TwistController,
};

use crate::actuation::{
    FingerDrive, HandActuation, NamedJointPositions, ServoArmController, ServoSettings,
};
use crate::embodiment_spec::{EmbodimentSceneParts, EmbodimentSpec, OPEN_APERTURE};
use crate::error::{EnvError, require};
use crate::mjcf::{Mjcf, parts};

/// Name of the robot's file.
const ROBOT: &str = "robot.xml";
/// Included files; objects and surroundings collide as with the Sawyer arm's gripper.
const INCLUDED: [Mjcf<'static>; 5] = parts!([
    "block.xml", "contacts.xml", "drawer_stop.xml", "peg_contacts.xml", "puck.xml"
] in "sawyer");
/// MJCF around the robot. Its servos need the implicit integrator. Only the gripper collides, and
/// not with itself, as with the Sawyer arm.
const MJCF: &str = r#"<mujocoinclude>
  <option integrator="implicit"/>
  <default>
    <default class="arm">
      <geom group="3" contype="0" conaffinity="0" rgba="0.6 0.6 0.65 1"/>
      <site size="0.01" group="5"/>
      <default class="robot_gripper">
        <geom contype="1" margin="0.001" condim="4" friction="1 0.005 0.0001" rgba="0.15 0.15 0.15 1"/>
      </default>
    </default>
  </default>
  <include file="robot.xml"/>
</mujocoinclude>"#;

/// Settings from which an [`Arm`] is built.
#[derive(Clone, Debug)]
pub struct ArmSettings {
    /// Name of the embodiment.
    pub name: String,
    /// Description of the robot, with its base where it stands in the scene (origin: centre of the
    /// table).
    pub robot: RobotDescription,
    /// Name of the robot's link that is the hand.
    pub hand_link: String,
    /// Joint positions between base and hand (radians, metres) with the hand in the orientation
    /// that it keeps, near the arm's working configurations.
    pub ready_joint_positions: Vec<f64>,
    /// Gripper of the arm.
    pub gripper: Gripper,
    /// Limits and inverse kinematics of the hand's motion; [`TwistControlSettings::lookahead_s`] is
    /// ignored.
    pub control: TwistControlSettings,
    /// Servos of all joints that follow no other, those of the gripper included.
    pub servo: JointServoSettings,
    /// Largest distance of the hand's target from the hand (metres). The target waits for an arm
    /// that is slow or blocked.
    pub max_target_lead: f64,
    /// Additional bodies on its links, for instance a ball for calibrating a camera.
    pub additions: Vec<LinkMjcfAddition>,
}

/// Gripper of an arm.
#[derive(Clone, Debug)]
pub struct Gripper {
    /// Name of the link that holds the gripper. Shapes of this link and of its descendants collide
    /// with objects; those of the arm do not.
    pub link: String,
    /// Right and left finger of the gripper.
    pub fingers: [Finger; 2],
    /// Joint that closes the fingers at its own speed. `None` for fingers that do not move.
    pub joint: Option<FingerJoint>,
}

/// Joint that opens and closes a gripper.
#[derive(Clone, Debug)]
pub struct FingerJoint {
    /// Name of the joint.
    pub name: String,
    /// Positions of the joint (metres, radians) with open and with closed fingers, both within its
    /// range.
    pub positions: [f64; 2],
}

/// Reference points of a gripper's finger.
#[derive(Clone, Debug)]
pub struct Finger {
    /// Name of the finger's link in the URDF.
    pub link: String,
    /// Point that tasks treat as the claw, in the link's frame (metres). Open claws are 0.1 m apart
    /// for tasks; wider counts as open, narrower as closing.
    pub claw_point: DVec3,
    /// Fingertip in the link's frame (metres).
    pub tip_point: DVec3,
}

/// Arm of a URDF, without a weld: inverse kinematics convert the motion of the hand's target to
/// joint targets, and servos within the effort limits of the joints follow them.
#[derive(Clone, Debug)]
pub struct Arm {
    settings: ArmSettings,
    chain: Chain,
    finger: Option<FingerDrive>,
    mjcf: String,
}

impl Arm {
    /// Builds an arm from its settings.
    ///
    /// # Errors
    /// [`EnvError::Robot`] for links that the robot does not have, [`EnvError::Control`] for
    /// control settings out of range, [`EnvError::InvalidSetting`] for the rest.
    pub fn new(settings: ArmSettings) -> Result<Self, EnvError> {
        let (robot, ready) = (&settings.robot, &settings.ready_joint_positions);
        let chain = Chain::new(robot, &settings.hand_link)?;
        let fits = ready.len() == chain.joints().len();
        let expected = "one position for each joint between base and hand";
        require(fits, "ready_joint_positions", &format!("{ready:?}"), expected)?;
        let positive = settings.max_target_lead > 0.0 && settings.max_target_lead.is_finite();
        require(
            positive,
            "max_target_lead",
            &settings.max_target_lead,
            "a positive length in metres",
        )?;
        // built only to check the settings; `actuation` builds the one that is used
        TwistController::new(chain.clone(), ready, settings.control)?;
        Ok(Self {
            finger: finger(robot, settings.gripper.joint.as_ref())?,
            mjcf: robot.to_mjcf_include(&mjcf_settings(&settings))?.text,
            chain,
            settings,
        })
    }

    /// Returns the description of the arm's robot.
    pub fn robot_description(&self) -> &RobotDescription {
        &self.settings.robot
    }

    /// Returns the kinematic chain of the joints between the base and the hand.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Returns the settings that the arm was built from.
    pub fn settings(&self) -> &ArmSettings {
        &self.settings
    }

    /// Returns capsules that enclose the whole arm in `state`, in the world frame. Their order and
    /// radii are constant.
    ///
    /// # Panics
    /// If the state has another number of joints.
    pub fn capsules(&self, state: &RobotState) -> Vec<Capsule> {
        let capsules = self.robot_description().enclosing_capsules(&self.positions(state));
        capsules.into_iter().map(|(_, capsule)| capsule).collect()
    }

    /// Returns the distance between the claws in `state` as learners observe it: in `[0, 1]`, 1 for
    /// an open gripper.
    ///
    /// # Panics
    /// If the state has another number of joints.
    pub fn aperture(&self, state: &RobotState) -> f64 {
        let robot = self.robot_description();
        let poses = robot.link_poses(&self.positions(state));
        let claw = |finger: &Finger| {
            let mut links = robot.links().iter().zip(&poses);
            let found = links.find(|(link, _)| link.name == finger.link);
            found.map(|(_, pose)| pose.transform_point(finger.claw_point))
        };
        match self.settings.gripper.fingers.each_ref().map(claw) {
            [Some(right), Some(left)] => (right.distance(left) / OPEN_APERTURE).clamp(0.0, 1.0),
            // unreachable, since `Arm::new` has found both links
            _ => 1.0,
        }
    }

    /// Returns the time in which open fingers close at their maximum speed (seconds); `None` for
    /// fingers that do not move.
    pub fn closing_seconds(&self) -> Option<f64> {
        let finger = self.finger?;
        Some(finger.travel() / finger.max_speed)
    }

    /// Returns the positions of all free joints. Joints other than the chain's and the fingers' are
    /// at rest.
    fn positions(&self, state: &RobotState) -> Vec<f64> {
        assert_eq!(state.joints.len(), self.chain.joints().len(), "joints of a state");
        let mut positions = self.robot_description().rest_positions();
        for (joint, position) in self.chain.joints().iter().zip(&state.joints) {
            positions[joint.dof_index] = *position;
        }
        if let Some(finger) = self.finger {
            positions[finger.dof] = finger.position_at_closure(state.gripper_closure);
        }
        positions
    }
}

/// Returns the drive of the fingers by a joint, which must be a free one with a range and a speed.
fn finger(
    robot: &RobotDescription,
    joint: Option<&FingerJoint>,
) -> Result<Option<FingerDrive>, EnvError> {
    let Some(FingerJoint { name, positions }) = joint else {
        return Ok(None);
    };
    let mut joints = robot.free_joints().enumerate();
    let found = joints.find(|(_, (free, _))| free.name == *name);
    let limits = found.and_then(|(dof, (_, motion))| Some((dof, motion.range?, motion.max_speed?)));
    let expected = "a joint of the robot that has limits, also of velocity, and follows no other";
    require(limits.is_some(), "gripper.joint", name, expected)?;
    let drive = limits.map(|(dof, [low, high], max_speed)| {
        let inside = positions.iter().all(|at| (low..=high).contains(at));
        let expected_positions = "two positions within the range of the joint";
        let differ = inside && positions[0] != positions[1];
        let value = format!("{positions:?}");
        require(differ, "gripper.joint.positions", &value, expected_positions)?;
        Ok::<_, EnvError>(FingerDrive { dof, positions: *positions, max_speed })
    });
    drive.transpose()
}

fn mjcf_settings(settings: &ArmSettings) -> MjcfSettings {
    let fingers = settings.gripper.fingers.iter().zip(["right", "left"]);
    let finger = |(finger, side): (&Finger, &str)| LinkMjcfAddition {
        link: finger.link.clone(),
        mjcf: format!(
            "<body name=\"{side}_claw\" pos=\"{}\"/>\n<site name=\"{side}_tip\" pos=\"{}\"/>\n",
            numbers(finger.claw_point),
            numbers(finger.tip_point)
        ),
    };
    let hand = LinkMjcfAddition {
        link: settings.hand_link.clone(),
        mjcf: "<body name=\"hand\"/>\n".to_owned(),
    };
    // the class of a link applies to its descendants, so the gripper's replaces the arm's there
    let root = settings.robot.links()[0].name.clone();
    let classes = [(root, "arm"), (settings.gripper.link.clone(), "robot_gripper")];
    MjcfSettings {
        servo: Some(settings.servo),
        link_classes: classes.map(|(link, class)| (link, class.to_owned())).to_vec(),
        additions: fingers
            .map(finger)
            .chain([hand])
            .chain(settings.additions.iter().cloned())
            .collect(),
    }
}

fn numbers(DVec3 { x, y, z }: DVec3) -> String {
    format!("{x} {y} {z}")
}

impl EmbodimentSpec for Arm {
    fn name(&self) -> &str {
        &self.settings.name
    }

    fn parts(&self) -> Result<EmbodimentSceneParts, EnvError> {
        let files = INCLUDED.map(|(name, text)| (name, text.into()));
        let robot = (ROBOT, self.mjcf.clone().into());
        Ok(EmbodimentSceneParts {
            mjcf: MJCF.into(),
            included_files: files.into_iter().chain([robot]).collect(),
        })
    }

    fn initial_joint_positions(&self, hand_target: DVec3) -> Result<NamedJointPositions, EnvError> {
        let ready = &self.settings.ready_joint_positions;
        let rotation = self.chain.tip_pose(ready).rotation;
        let target = Pose { position: hand_target, rotation };
        let orientation = self.settings.control.orientation;
        // no limit of time, which would make episodes depend on the load of the machine
        let settings =
            IkSettings { orientation, time_limit: Duration::MAX, ..IkSettings::default() };
        let joints = self.chain.solve_ik_with_settings(&target, ready, &settings)?;
        let state = RobotState { tip: target, joints, gripper_closure: 0.0 };
        let positions = self.positions(&state);
        let moving = self.robot_description().joints().iter().filter_map(|joint| {
            let position = joint.motion?.position_from_dofs(&positions);
            Some((joint.name.clone(), position))
        });
        Ok(moving.collect())
    }

    fn actuation(&self) -> Result<HandActuation, EnvError> {
        let ArmSettings { robot, ready_joint_positions: ready, servo, max_target_lead, .. } =
            &self.settings;
        let control = TwistControlSettings {
            // no look-ahead, so that a target out of reach is no error: the arm stops where its
            // reach ends
            lookahead_s: 0.0,
            ..self.settings.control
        };
        let servos = ServoSettings {
            arm: robot.clone(),
            servo: *servo,
            hand_rotation: self.chain.tip_pose(ready).rotation,
            finger: self.finger,
            max_target_lead: *max_target_lead,
            limits: control.limits,
            orientation: control.orientation,
        };
        let control = TwistController::new(self.chain.clone(), ready, control)?;
        Ok(HandActuation::Servos(Box::new(ServoArmController::new(servos, control))))
    }
}

//! An arm of a URDF whose servos follow inverse kinematics.

use glam::DVec3;
use robots::{
    Addition, Capsule, CartesianControl, Chain, ControlSettings, Description, Drive as JointDrive,
    MjcfSettings, Pose, RobotState, Servo,
};

use crate::carrier::{Carrier, CarrierParts, OPEN_APERTURE};
use crate::drive::{Drive, Posture, ServoDrive, Servos};
use crate::error::{EnvError, require};
use crate::mjcf::{Mjcf, parts};

/// File name of the robot itself.
const ROBOT: &str = "robot.xml";
/// Objects and surroundings are as the Sawyer arm's gripper meets them.
const INCLUDED: [Mjcf<'static>; 3] =
    parts!(["contacts.xml", "drawer_stop.xml", "puck.xml"] in "sawyer");
/// Servos need the implicit integrator. As of the Sawyer arm, the gripper alone collides, and not
/// with itself.
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

/// What turns a robot into an embodiment.
#[derive(Clone, Debug)]
pub struct ArmSettings {
    /// Name of the embodiment.
    pub name: String,
    /// The robot, its base where it stands in the scene (the origin is the centre of the table).
    pub robot: Description,
    /// The link that is the hand.
    pub hand: String,
    /// Joints between base and hand (radians, metres) in which the hand is turned as it shall stay,
    /// near the postures that it works in.
    pub ready: Vec<f64>,
    /// The gripper.
    pub gripper: Gripper,
    /// How the hand moves; [`ControlSettings::horizon`] plays no part.
    pub control: ControlSettings,
    /// Servos of all joints.
    pub servo: Servo,
    /// The furthest that the hand's target is ahead of the hand (metres): the target waits for an
    /// arm that is slow, or that something holds back.
    pub lead: f64,
    /// What its links carry besides, for instance a ball that a camera is calibrated by.
    pub additions: Vec<Addition>,
}

/// What an arm grips with.
#[derive(Clone, Debug)]
pub struct Gripper {
    /// The link that holds it. Shapes of this link, and of all that hangs on it, collide with the
    /// objects; those of the arm do not.
    pub link: String,
    /// The right finger, and the left one.
    pub fingers: [Finger; 2],
    /// The joint that closes them from one end of its range to the other, at its own speed; none
    /// for fingers that do not move.
    pub joint: Option<String>,
}

/// Points of a finger.
#[derive(Clone, Debug)]
pub struct Finger {
    /// The link.
    pub link: String,
    /// Where tasks look for the claw, in the link's frame (metres). The two claws of an open
    /// gripper are 0.1 m apart for tasks; wider ones count as open, narrower ones as closing.
    pub claw: DVec3,
    /// The fingertip in the link's frame (metres).
    pub tip: DVec3,
}

/// An arm of a URDF. It has no weld: inverse kinematics within its limits make joint commands of
/// the hand's target, and servos with the arm's own efforts follow them.
#[derive(Clone, Debug)]
pub struct Arm {
    settings: ArmSettings,
    chain: Chain,
    finger: Option<usize>,
    mjcf: robots::Mjcf,
}

impl Arm {
    /// # Errors
    /// [`EnvError::Robot`] for links that the robot does not have, [`EnvError::Control`] for
    /// control settings out of range, [`EnvError::Setting`] for the rest.
    pub fn new(settings: ArmSettings) -> Result<Self, EnvError> {
        let (robot, ready) = (&settings.robot, &settings.ready);
        let chain = Chain::new(robot, &settings.hand)?;
        let fits = ready.len() == chain.joints().len();
        let expected = "one position for each joint between base and hand";
        require(fits, "ready", &format!("{ready:?}"), expected)?;
        let positive = settings.lead > 0.0 && settings.lead.is_finite();
        require(positive, "lead", &settings.lead, "a positive length in metres")?;
        CartesianControl::new(chain.clone(), ready, settings.control)?;
        Ok(Self {
            finger: finger(robot, settings.gripper.joint.as_deref())?,
            mjcf: robot.to_mjcf_part(&mjcf_settings(&settings))?,
            chain,
            settings,
        })
    }

    /// The robot.
    pub fn robot(&self) -> &Description {
        &self.settings.robot
    }

    /// The joints between the base and the hand.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// What it was made of.
    pub fn settings(&self) -> &ArmSettings {
        &self.settings
    }

    /// Pairs of links that touch at rest and therefore do not collide in any pose
    /// ([`robots::Mjcf::excluded`]). The scene lets the gripper alone collide, and not with itself.
    pub fn excluded(&self) -> &[[String; 2]] {
        &self.mjcf.excluded
    }

    /// Capsules that hold the whole arm where it says that it is, in the world. Their order and
    /// their radii are always the same.
    ///
    /// # Panics
    /// Where the state is of an arm with another number of joints.
    pub fn capsules(&self, state: &RobotState) -> Vec<Capsule> {
        let capsules = self.robot().capsules(&self.positions(state));
        capsules.into_iter().map(|(_, capsule)| capsule).collect()
    }

    /// How far the claws are apart where the arm says that it is, as learners are told it: in
    /// `[0, 1]`, 1 for an open gripper.
    ///
    /// # Panics
    /// As [`Arm::capsules`].
    pub fn aperture(&self, state: &RobotState) -> f64 {
        let robot = self.robot();
        let poses = robot.poses(&self.positions(state));
        let claw = |finger: &Finger| {
            let mut links = robot.links().iter().zip(&poses);
            let found = links.find(|(link, _)| link.name == finger.link);
            found.map(|(_, pose)| pose.point(finger.claw))
        };
        match self.settings.gripper.fingers.each_ref().map(claw) {
            [Some(right), Some(left)] => (right.distance(left) / OPEN_APERTURE).clamp(0.0, 1.0),
            // `Arm::new` has found the links
            _ => 1.0,
        }
    }

    /// Seconds in which the fingers close; none for fingers that do not move.
    pub fn closing_time(&self) -> Option<f64> {
        let (_, motion) = self.robot().free_joints().nth(self.finger?)?;
        motion.range.map(|[low, high]| (high - low) / motion.speed)
    }

    /// The finger joint and those that follow it, where they are open.
    fn open_fingers(&self) -> impl Iterator<Item = (String, f64)> {
        let robot = self.robot();
        let mut positions = vec![0.0; robot.dofs()];
        if let Some((dof, [open, _])) = self.finger_range() {
            positions[dof] = open;
        }
        robot.joints().iter().filter_map(move |joint| {
            let motion = joint.motion.as_ref()?;
            let (JointDrive::Free { dof } | JointDrive::Follows { dof, .. }) = motion.drive;
            let position = motion.position(&positions);
            (Some(dof) == self.finger).then(|| (joint.name.clone(), position))
        })
    }

    /// Index of the finger joint among the free ones, and where it is open and closed.
    fn finger_range(&self) -> Option<(usize, [f64; 2])> {
        let dof = self.finger?;
        let (_, motion) = self.robot().free_joints().nth(dof)?;
        Some((dof, motion.range?))
    }

    /// Positions of all free joints; those beside the chain and the fingers are at zero.
    fn positions(&self, state: &RobotState) -> Vec<f64> {
        let robot = self.robot();
        assert_eq!(state.joints.len(), self.chain.joints().len(), "joints of a state");
        let mut positions = vec![0.0; robot.dofs()];
        for (joint, position) in self.chain.joints().iter().zip(&state.joints) {
            positions[joint.dof] = *position;
        }
        if let Some((dof, [open, closed])) = self.finger_range() {
            positions[dof] = open + state.closing * (closed - open);
        }
        positions
    }
}

/// Index of the finger joint, which is a free joint with a range.
fn finger(robot: &Description, joint: Option<&str>) -> Result<Option<usize>, EnvError> {
    let Some(name) = joint else {
        return Ok(None);
    };
    let mut joints = robot.free_joints();
    let found = joints.position(|(joint, motion)| joint.name == name && motion.range.is_some());
    let expected = "a joint of the robot that has limits and follows no other";
    require(found.is_some(), "gripper.joint", &name, expected)?;
    Ok(found)
}

fn mjcf_settings(settings: &ArmSettings) -> MjcfSettings {
    let fingers = settings.gripper.fingers.iter().zip(["right", "left"]);
    let finger = |(finger, side): (&Finger, &str)| Addition {
        link: finger.link.clone(),
        mjcf: format!(
            "<body name=\"{side}_claw\" pos=\"{}\"/>\n<site name=\"{side}_tip\" pos=\"{}\"/>\n",
            numbers(finger.claw),
            numbers(finger.tip)
        ),
    };
    let hand = Addition { link: settings.hand.clone(), mjcf: "<body name=\"hand\"/>\n".to_owned() };
    let root = settings.robot.links()[0].name.clone();
    let classes = [(root, "arm"), (settings.gripper.link.clone(), "robot_gripper")];
    MjcfSettings {
        servo: Some(settings.servo),
        classes: classes.map(|(link, class)| (link, class.to_owned())).to_vec(),
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

impl Carrier for Arm {
    fn name(&self) -> &str {
        &self.settings.name
    }

    fn parts(&self) -> Result<CarrierParts, EnvError> {
        let files = INCLUDED.map(|(name, text)| (name, text.into()));
        let robot = (ROBOT, self.mjcf.text.clone().into());
        Ok(CarrierParts { mjcf: MJCF.into(), included: files.into_iter().chain([robot]).collect() })
    }

    fn posture(&self, hand_target: DVec3) -> Result<Posture, EnvError> {
        let ready = &self.settings.ready;
        let target = Pose { position: hand_target, rotation: self.chain.tip(ready).rotation };
        let solved = self.chain.solve(&target, ready)?;
        let joints = self.chain.joints().iter();
        let arm = joints.map(|joint| joint.name.clone()).zip(solved);
        Ok(arm.chain(self.open_fingers()).collect())
    }

    fn drive(&self) -> Result<Drive, EnvError> {
        let ArmSettings { robot, ready, servo, lead, .. } = &self.settings;
        let control = ControlSettings {
            // a target out of reach is nothing to refuse: the arm stands where its reach ends
            horizon: 0.0,
            ..self.settings.control
        };
        let servos = Servos {
            arm: robot.clone(),
            servo: *servo,
            rotation: self.chain.tip(ready).rotation,
            finger: self.finger,
            lead: *lead,
            limits: control.limits,
        };
        let control = CartesianControl::new(self.chain.clone(), ready, control)?;
        Ok(Drive::Servos(Box::new(ServoDrive::new(servos, control))))
    }
}

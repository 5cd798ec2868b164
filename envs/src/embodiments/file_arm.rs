//! Arm of a user's own file: gripper, place at the table and settings of its control.

use glam::{DMat3, DQuat, DVec3};
use robots::{
    Chain, Inertia, JointMotionKind, JointServoSettings, Link, MjcfSettings, PlacedShape, Pose,
    RobotDescription, RobotFile, Shape, TwistControlSettings, TwistController, TwistLimits,
};

use super::arm::{Arm, ArmSettings, Finger, FingerJoint, Gripper};
use super::kinova_gen3::{ACCELERATION, LEAD};
use super::placing::{BasePlacementSearch, gripper_rotation};
use crate::embodiment_spec::OPEN_APERTURE;
use crate::error::EnvError;

/// Prefix of the names of links and joints, which a scene could have otherwise.
const PREFIX: &str = "robot/";
/// Links that are added: the hand as tasks know it, and the gripper of arms that have none.
const HAND: &str = "gripper_hand";
const PALM: &str = "gripper_palm";
const FINGERS: [&str; 2] = ["gripper_right", "gripper_left"];
/// Distance of the fingertips from the hand (metres), which scripted experts assume.
const HAND_TO_TIP: f64 = 0.045;
/// Distance from the robot's own hand to [`HAND`] with our gripper (metres).
const FLANGE_TO_HAND: f64 = 0.09;
/// Distance from the middle to the outside of open fingers (metres), as of the Sawyer arm's.
const OPEN_HALF_WIDTH: f64 = 0.053;
/// Maximum stiffness of a hinge's servo (newton metres per radian), three times that of a Kinova
/// Gen3. Scripted experts slide a puck by pressing on it, and a stiffer arm presses it away; with
/// 2000, a long arm is too weak to press a button home.
const MAX_STIFFNESS: f64 = 6000.0;
/// Minimum distance by which the outside of a finger moves outwards (metres).
const MIN_TRAVEL: f64 = 1e-3;

impl Arm {
    /// Builds an arm called `name` from the robot that `file` describes, with its base placed at
    /// the table. If nothing moves on its hand, it gets a gripper with two fixed claws, 0.1 m
    /// apart. Its base stands where the hand, pointing down, reaches all positions of the four
    /// groups of the paper; links and joints have the prefix `robot/`.
    ///
    /// # Errors
    /// [`EnvError::Robot`] for a robot that cannot be read or simulated and for a base that no arm
    /// can have, [`EnvError::OutOfReach`], [`EnvError::InvalidFingers`], [`EnvError::Control`] for
    /// joints without maximum speed.
    pub fn from_file(name: &str, file: &RobotFile) -> Result<Self, EnvError> {
        file.check_base()?;
        let plain = file.read_description()?;
        let hand = file.hand_link(&plain);
        reject_unusable(&plain, hand)?;
        let fingers = file.finger_links(&plain)?;
        let axis = file.approach_axis(&plain)?;
        let own = fingers.map(|names| OwnFingers::find(&plain, hand, axis, names)).transpose()?;
        let frame = own.as_ref().map_or_else(|| mounting_frame(axis), |own| own.frame);
        let hand = format!("{PREFIX}{hand}");
        let robot = plain.with_prefix(PREFIX)?;
        let framed = robot.clone().with_fixed_link(&hand, frame, bare(HAND))?;
        let placed = BasePlacementSearch {
            robot: &framed,
            hand: HAND,
            quarter_turns: if own.is_some() { &[0, 2] } else { &[0, 1, 2, 3] },
            base_position: file.base_position.map(DVec3::from_array),
            base_yaw: file.base_yaw_degrees.unwrap_or(90.0).to_radians(),
        }
        .search()?;
        let turned =
            Pose { rotation: frame.rotation * gripper_rotation(placed.quarter_turns), ..frame };
        let (robot, gripper) = match own {
            None => with_gripper(robot, &hand, turned)?,
            Some(own) => {
                let swapped = placed.quarter_turns > 0;
                (robot.with_fixed_link(&hand, turned, bare(HAND))?, own.gripper(hand, swapped))
            }
        };
        Self::new(ArmSettings {
            name: name.to_owned(),
            robot: robot.with_base_pose(placed.base)?,
            hand_link: HAND.to_owned(),
            ready_joint_positions: placed.ready,
            gripper,
            control: TwistControlSettings {
                limits: TwistLimits { max_acceleration: ACCELERATION, ..TwistLimits::default() },
                orientation: placed.orientation,
                ..TwistControlSettings::default()
            },
            servo: soft_servos(&Chain::new(&framed, HAND)?),
            max_target_lead: LEAD,
            additions: Vec::new(),
        })
    }
}

/// Rejects a robot that cannot be controlled or simulated, while its links and joints still have the
/// names of their file.
///
/// # Errors
/// [`EnvError::Robot`], [`EnvError::Control`].
fn reject_unusable(robot: &RobotDescription, hand: &str) -> Result<(), EnvError> {
    let chain = Chain::new(robot, hand)?;
    let middle = chain.quasi_random_configuration(0);
    TwistController::new(chain, &middle, TwistControlSettings::default())?;
    let servo = Some(JointServoSettings::default());
    robot.to_mjcf(&MjcfSettings { servo, ..MjcfSettings::default() })?;
    Ok(())
}

/// Returns servos with which the stiffest hinge of the arm, `chain`, is at most as stiff as
/// [`MAX_STIFFNESS`]. All joints of the robot are softened alike.
// Efforts of fingers are often placeholders, so they must not soften the arm.
fn soft_servos(chain: &Chain) -> JointServoSettings {
    let motions = chain.joints().iter().map(|joint| &joint.motion);
    let hinges = motions.filter(|motion| motion.kind == JointMotionKind::Hinge);
    let largest = hinges.filter_map(|motion| motion.max_effort).fold(0.0, f64::max);
    let usual = JointServoSettings::default();
    let saturation_error = usual.saturation_error.max(largest / MAX_STIFFNESS);
    JointServoSettings { saturation_error, ..usual }
}

/// Returns the rotation of a frame with its z along `axis` and its y along `sideways`, which are
/// unit vectors across each other.
fn along(axis: DVec3, sideways: DVec3) -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(sideways.cross(axis), sideways, axis))
}

/// Returns a link without shapes and mass.
fn bare(name: &str) -> Link {
    Link { name: name.to_owned(), inertia: None, shapes: Vec::new() }
}

/// Returns a box with a mass (kg), given its centre and half extents (metres).
fn solid(name: &str, mass: f64, centre: DVec3, half_extents: DVec3) -> Link {
    let square = half_extents * half_extents;
    let moments = DVec3::splat(square.element_sum()) - square;
    let tensor = DMat3::from_diagonal(mass / 3.0 * moments);
    Link {
        name: name.to_owned(),
        inertia: Some(Inertia { mass, centre_of_mass: centre, tensor }),
        shapes: vec![PlacedShape {
            pose: Pose::from_position(centre),
            shape: Shape::Box { half_extents },
        }],
    }
}

/// Returns the frame of our gripper on a hand that reaches out along `axis`.
fn mounting_frame(axis: DVec3) -> Pose {
    Pose { position: FLANGE_TO_HAND * axis, rotation: along(axis, axis.any_orthonormal_vector()) }
}

/// Adds a gripper with fixed claws, of the sizes of the Sawyer arm's, whose hand is at `frame` on
/// the link `hand`.
fn with_gripper(
    robot: RobotDescription,
    hand: &str,
    frame: Pose,
) -> Result<(RobotDescription, Gripper), EnvError> {
    let palm = solid(PALM, 0.15, DVec3::new(0.0, 0.0, -0.0658), DVec3::new(0.033, 0.0528, 0.0267));
    let mut robot = robot.with_fixed_link(hand, frame, palm)?.with_fixed_link(
        PALM,
        Pose::IDENTITY,
        bare(HAND),
    )?;
    let half_extents = DVec3::new(0.015, 0.0045, HAND_TO_TIP);
    for (name, side) in FINGERS.iter().zip([-1.0, 1.0]) {
        let centre = DVec3::new(0.0, side * (OPEN_HALF_WIDTH - half_extents.y), 0.0);
        let finger = solid(name, 0.02, centre, half_extents);
        robot = robot.with_fixed_link(PALM, Pose::IDENTITY, finger)?;
    }
    let finger = |(link, side): (&str, f64)| Finger {
        link: link.to_owned(),
        claw_point: DVec3::new(0.0, side * 0.5 * OPEN_APERTURE, 0.0),
        tip_point: DVec3::new(0.0, side * 0.5 * OPEN_APERTURE, HAND_TO_TIP),
    };
    let [right, left] = FINGERS;
    let fingers = [(right, -1.0), (left, 1.0)].map(finger);
    Ok((robot, Gripper { link: PALM.to_owned(), fingers, joint: None }))
}

/// Fingers of the robot itself.
struct OwnFingers {
    /// Frame of the hand on the robot's hand, with its z downwards at work.
    frame: Pose,
    /// Fingers; the second one is on the side of the frame's y.
    fingers: [Finger; 2],
    joint: FingerJoint,
}

impl OwnFingers {
    /// Finds the frame of the hand on the link `hand`, with its z along `axis` and its y from the
    /// first finger to the second, and the reference points of the fingers.
    ///
    /// # Errors
    /// [`EnvError::InvalidFingers`]; [`EnvError::Robot`] if no chain leads to the hand.
    fn find(
        robot: &RobotDescription,
        hand: &str,
        axis: DVec3,
        names: [String; 2],
    ) -> Result<Self, EnvError> {
        let refuse = |reason| EnvError::InvalidFingers { fingers: names.clone(), reason };
        let index = |name: &str| robot.links().iter().position(|link| link.name == name);
        let found = index(hand).and_then(|hand_index| {
            let on_hand = robot.descendants(hand_index);
            let [one, other] =
                names.each_ref().map(|name| index(name).filter(|link| on_hand.contains(link)));
            Some([hand_index, one?, other?])
        });
        let Some(indices @ [_, one, other]) = found else {
            return Err(refuse("the hand has no such links"));
        };
        if [one, other].iter().any(|&link| robot.links()[link].shapes.is_empty()) {
            return Err(refuse("their tips are those of their shapes, and they have none"));
        }
        let driving_dof = |link: usize| Some(robot.joints()[link - 1].motion?.drive.dof_index());
        let shared = driving_dof(one).filter(|_| driving_dof(one) == driving_dof(other));
        let driving = shared.and_then(|dof| Some((dof, robot.free_joints().nth(dof)?)));
        let Some((dof, (joint, motion))) = driving else {
            return Err(refuse("one joint must move both, the other one following it"));
        };
        if Chain::new(robot, hand)?.joints().iter().any(|of| of.dof_index == dof) {
            return Err(refuse("a joint between the base and the hand moves them"));
        }
        let Some([low, high]) = motion.range else {
            return Err(refuse("the joint that moves them has no range"));
        };
        let at = |position| {
            let mut positions = robot.rest_positions();
            positions[dof] = position;
            FingerPoses::new(robot, indices, &positions)
        };
        let (lower, upper) = (at(low), at(high));
        let opens_down = lower.distance() > upper.distance();
        let (widest, wide, closed) =
            if opens_down { (&lower, low, high) } else { (&upper, high, low) };
        let sideways = widest.sideways(axis).ok_or_else(|| refuse("they do not move apart"))?;
        // no farther open than fingers that come down in front of what they push
        let [most, least] = [wide, closed].map(|position| at(position).outside(sideways));
        if most - least < MIN_TRAVEL {
            return Err(refuse("they do not move outwards by a millimetre or more"));
        }
        if least >= OPEN_HALF_WIDTH {
            return Err(refuse("closed, they are 106 mm wide or more, too wide for the tasks"));
        }
        let opening = ((OPEN_HALF_WIDTH - least) / (most - least)).min(1.0);
        let open = closed + opening * (wide - closed);
        let (frame, fingers) = at(open).frame_and_fingers(axis, sideways, &names);
        let name = joint.name.clone();
        Ok(Self { frame, fingers, joint: FingerJoint { name, positions: [open, closed] } })
    }

    /// Returns the gripper on the link `hand`; `swapped` if the second finger is the right one.
    fn gripper(self, hand: String, swapped: bool) -> Gripper {
        let [first, second] = self.fingers;
        let fingers = if swapped { [second, first] } else { [first, second] };
        let prefixed = |name: String| format!("{PREFIX}{name}");
        let fingers = fingers.map(|finger| Finger { link: prefixed(finger.link), ..finger });
        let joint = FingerJoint { name: prefixed(self.joint.name), ..self.joint };
        Gripper { link: hand, fingers, joint: Some(joint) }
    }
}

/// Two fingers in one position of their joint, in the frame of the robot's hand.
struct FingerPoses<'a> {
    shapes: [&'a [PlacedShape]; 2],
    poses: [Pose; 2],
}

impl<'a> FingerPoses<'a> {
    /// Places the fingers, given the indices of the hand's and the fingers' links, and the position
    /// vector of the robot.
    fn new(robot: &'a RobotDescription, [hand, one, other]: [usize; 3], positions: &[f64]) -> Self {
        let poses = robot.link_poses(positions);
        let turn = poses[hand].rotation.conjugate();
        let in_hand = |link: usize| Pose {
            position: turn * (poses[link].position - poses[hand].position),
            rotation: turn * poses[link].rotation,
        };
        let shapes = [one, other].map(|link| &robot.links()[link].shapes[..]);
        Self { shapes, poses: [one, other].map(in_hand) }
    }

    /// Returns the mean of the centres of a finger's shapes.
    fn centre(&self, finger: usize) -> DVec3 {
        let shapes = self.shapes[finger];
        let centres = shapes.iter().map(|of| self.poses[finger].transform_point(of.pose.position));
        centres.sum::<DVec3>() / shapes.len() as f64
    }

    fn distance(&self) -> f64 {
        self.centre(0).distance(self.centre(1))
    }

    /// Returns the direction across `axis` from the first finger to the second.
    fn sideways(&self, axis: DVec3) -> Option<DVec3> {
        (self.centre(1) - self.centre(0)).reject_from(axis).try_normalize()
    }

    /// Returns how far a finger's shapes reach in a direction (metres).
    fn furthest(&self, finger: usize, way: DVec3) -> f64 {
        let points =
            self.shapes[finger].iter().map(|of| of.furthest_point(&self.poses[finger], way));
        points.map(|point| point.dot(way)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns the distance from the middle to the outside of the fingers (metres).
    fn outside(&self, sideways: DVec3) -> f64 {
        0.5 * (self.furthest(1, sideways) + self.furthest(0, -sideways))
    }

    /// Returns the frame of the hand as tasks know it, between the fingers and [`HAND_TO_TIP`]
    /// above their tips, and the fingers with their reference points, as if open claws were 0.1 m
    /// apart.
    fn frame_and_fingers(
        &self,
        axis: DVec3,
        sideways: DVec3,
        names: &[String; 2],
    ) -> (Pose, [Finger; 2]) {
        let depth = self.furthest(0, axis).max(self.furthest(1, axis));
        let inner = [self.furthest(0, sideways), -self.furthest(1, -sideways)];
        let between = inner[0].midpoint(inner[1]);
        let middle = self.centre(0).midpoint(self.centre(1));
        let level = middle.reject_from(axis).reject_from(sideways) + (depth - HAND_TO_TIP) * axis;
        let finger = |side: usize| {
            let Pose { position, rotation } = self.poses[side];
            let own = |point: DVec3| rotation.conjugate() * (point - position);
            let claw = between + (side as f64 - 0.5) * OPEN_APERTURE;
            Finger {
                link: names[side].clone(),
                claw_point: own(level + claw * sideways),
                tip_point: own(level + inner[side] * sideways + HAND_TO_TIP * axis),
            }
        };
        let position = level + between * sideways;
        (Pose { position, rotation: along(axis, sideways) }, [0, 1].map(finger))
    }
}

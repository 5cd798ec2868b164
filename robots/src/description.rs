//! Kinematic tree of a robot: links, joints, and their poses.

use glam::{DMat3, DQuat, DVec3};

use crate::capsule::{Capsule, PlacedShape};
use crate::error::DescriptionError;
use crate::pose::Pose;

/// Maximum number of links of a robot.
pub const MAX_LINKS: usize = 1000;
/// Maximum number of collision shapes of a link.
pub(crate) const MAX_SHAPES: usize = 1000;
/// Maximum length of a name (bytes).
const MAX_NAME: usize = 200;

/// Robot as a tree of links, made and validated by [`RobotDescription::from_urdf_file`] and
/// [`RobotDescription::from_urdf`].
///
/// A *position vector* `[num_dofs]` holds one number for each joint that moves and follows no
/// other, in the order of [`RobotDescription::joints`]: radians of a hinge, metres of a slide.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotDescription {
    pub(crate) name: String,
    pub(crate) base_pose: Pose,
    /// Links, parents before children; the root is the first.
    pub(crate) links: Vec<Link>,
    /// Joints; joint i carries link i + 1.
    pub(crate) joints: Vec<Joint>,
    pub(crate) num_dofs: usize,
    pub(crate) restrictions: Vec<JointRangeRestriction>,
    pub(crate) notes: Vec<String>,
    pub(crate) unit_warnings: Vec<String>,
    pub(crate) missing_shapes: Vec<String>,
}

/// Reduction of a free joint's range, so that a joint that follows it stays within its own range.
#[derive(Clone, Debug, PartialEq)]
pub struct JointRangeRestriction {
    /// Name of the free joint.
    pub joint: String,
    /// Name of the joint that follows it.
    pub follower: String,
    /// Range in the file (radians, metres); `None` for a joint without limits.
    pub file_range: Option<[f64; 2]>,
    /// Reduced range, in which the follower stays within its own.
    pub range: [f64; 2],
}

/// Rigid body of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Name, unique among the links.
    pub name: String,
    /// Mass and inertia in the file, possible or not, or as repaired
    /// ([`UrdfSettings::repair`](crate::UrdfSettings::repair)); `None` for a frame without mass.
    pub inertia: Option<Inertia>,
    /// Collision shapes, in the link's frame.
    pub shapes: Vec<PlacedShape>,
}

/// Mass of a link, its centre of mass and its inertia tensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass in the link's frame (metres).
    pub centre_of_mass: DVec3,
    /// Inertia about the centre of mass, with the link's axes (kg m^2).
    pub tensor: DMat3,
}

impl Inertia {
    /// Returns the inertia with the axes of another frame, in which the link's frame has `pose`.
    pub(crate) fn in_frame(&self, pose: &Pose) -> Self {
        let turn = DMat3::from_quat(pose.rotation);
        Self {
            mass: self.mass,
            centre_of_mass: pose.transform_point(self.centre_of_mass),
            tensor: turn * self.tensor * turn.transpose(),
        }
    }
}

/// Joint that fixes a link to its parent, or lets it move.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name, unique among the joints.
    pub name: String,
    /// Index of the parent link.
    pub parent: usize,
    /// Pose of the link in its parent's frame, with the joint at zero.
    pub origin: Pose,
    /// Motion of the link; `None` for a fixed joint.
    pub motion: Option<JointMotionSpec>,
}

/// Possible motion of a joint: its kind, axis and limits, and the source of its position. Units are
/// metres and newtons for a slide, radians and newton metres for a hinge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMotionSpec {
    /// Turning or sliding.
    pub kind: JointMotionKind,
    /// Unit vector in the joint's frame.
    pub axis: DVec3,
    /// Lowest and highest position; `None` for a joint without limits. A file may state them the
    /// wrong way round; control, inverse kinematics and MJCF refuse such a joint.
    pub range: Option<[f64; 2]>,
    /// Maximum speed (m/s, rad/s); `None` if the file states none from 1e-6 to 1e6.
    pub max_speed: Option<f64>,
    /// Maximum force or torque; `None` if the file states none from 1e-6 to 1e6.
    pub max_effort: Option<f64>,
    /// Viscous damping: force per speed.
    pub damping: f64,
    /// Dry friction.
    pub friction: f64,
    /// Source of the joint's position.
    pub drive: JointPositionSource,
}

/// Kind of motion: rotation about an axis, or translation along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointMotionKind {
    /// Rotation.
    Hinge,
    /// Translation.
    Slide,
}

/// Source of a joint's position: the position vector, or another joint that it follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointPositionSource {
    /// Element of the position vector.
    Free {
        /// Index in the position vector.
        dof: usize,
    },
    /// Linear function of another joint's position: URDF's `<mimic>`.
    Follows {
        /// Index of the followed joint in the position vector.
        dof: usize,
        /// Position per unit of the followed joint's position.
        multiplier: f64,
        /// Position with the followed joint at zero.
        offset: f64,
    },
}

impl JointPositionSource {
    /// Returns the index in the position vector that determines the joint's position.
    pub fn dof_index(self) -> usize {
        match self {
            Self::Free { dof } | Self::Follows { dof, .. } => dof,
        }
    }
}

impl JointMotionSpec {
    /// Returns the joint's position, given the position vector `positions`.
    pub fn position_from_dofs(&self, positions: &[f64]) -> f64 {
        match self.drive {
            JointPositionSource::Free { dof } => positions[dof],
            JointPositionSource::Follows { dof, multiplier, offset } => {
                multiplier * positions[dof] + offset
            }
        }
    }

    /// Returns `true` if the joint's position is an element of the position vector.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self.drive, JointPositionSource::Free { .. })
    }

    /// Returns the pose of the link in the joint's frame, with the joint at `position`.
    pub(crate) fn pose(&self, position: f64) -> Pose {
        match self.kind {
            JointMotionKind::Slide => Pose::from_position(position * self.axis),
            JointMotionKind::Hinge => Pose {
                position: DVec3::ZERO,
                rotation: DQuat::from_axis_angle(self.axis, position),
            },
        }
    }
}

impl RobotDescription {
    /// Returns the robot's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the links, parents before children; the first is the root.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Returns the joints; joint i carries link i + 1.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Returns the index of the link `name`. The error names `requested_by`, which refers to the
    /// link.
    pub(crate) fn link_index(
        &self,
        name: &str,
        requested_by: &str,
    ) -> Result<usize, DescriptionError> {
        let found = self.links.iter().position(|link| link.name == name);
        found.ok_or_else(|| DescriptionError::UnknownLink {
            link: name.to_owned(),
            requested_by: requested_by.to_owned(),
            known: self.links.iter().map(|link| link.name.clone()).collect(),
        })
    }

    /// Returns the length of the robot's position vectors: the number of its free joints.
    pub fn num_dofs(&self) -> usize {
        self.num_dofs
    }

    /// Returns the free joints, which move and follow no other, in the order of position vectors.
    pub fn free_joints(&self) -> impl Iterator<Item = (&Joint, &JointMotionSpec)> {
        let moving = |joint| Joint::motion(joint).map(|motion| (joint, motion));
        let joints = self.joints.iter().filter_map(moving);
        joints.filter(|(_, motion)| motion.is_free())
    }

    /// Returns the free joints whose ranges were reduced while the URDF was read, so that those that
    /// follow them stay within their own ranges.
    pub fn range_restrictions(&self) -> &[JointRangeRestriction] {
        &self.restrictions
    }

    /// Returns notes on values of the file that were replaced or left out, for the user.
    pub fn import_notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns a text for each collision shape of the URDF that this robot lacks: its place and the
    /// reason, a mesh that could not be read or a size below 1e-6 m. Meshes that
    /// [`UrdfSettings::ignore_meshes`](crate::UrdfSettings::ignore_meshes) leaves out, and those
    /// without points, are not named.
    pub fn missing_shape_reasons(&self) -> &[String] {
        &self.missing_shapes
    }

    /// Returns the position vector of the robot at rest: for each joint zero, or the end of its
    /// range nearest to zero.
    pub fn rest_positions(&self) -> Vec<f64> {
        let nearest = |[low, high]: [f64; 2]| 0_f64.max(low).min(high);
        let joints = self.free_joints();
        joints.map(|(_, motion)| motion.range.map_or(0.0, nearest)).collect()
    }

    /// Returns the pose of the root link in the world: the identity, unless set by
    /// [`RobotDescription::with_base_pose`].
    pub fn base_pose(&self) -> Pose {
        self.base_pose
    }

    /// Returns the poses of all links in the world, in the order of [`RobotDescription::links`].
    ///
    /// # Panics
    /// If `positions` is not of length [`RobotDescription::num_dofs`].
    pub fn link_poses(&self, positions: &[f64]) -> Vec<Pose> {
        check_length("positions", positions.len(), self.num_dofs);
        let mut poses = Vec::with_capacity(self.links.len());
        poses.push(self.base_pose);
        // parents come before children, so the parent's pose is known already
        for joint in &self.joints {
            let moved =
                joint.motion().map(|motion| motion.pose(motion.position_from_dofs(positions)));
            poses.push(poses[joint.parent] * joint.origin * moved.unwrap_or(Pose::IDENTITY));
        }
        poses
    }

    /// Returns capsules in the world that enclose all shapes of the robot in `positions`, each with
    /// the index of its link. [`RobotDescription::missing_shape_reasons`] names shapes that are
    /// not among them.
    ///
    /// # Panics
    /// If `positions` is not of length [`RobotDescription::num_dofs`].
    pub fn enclosing_capsules(&self, positions: &[f64]) -> Vec<(usize, Capsule)> {
        let links = self.links.iter().zip(self.link_poses(positions)).enumerate();
        let of_link = |(index, (link, pose)): (usize, (&Link, Pose))| {
            let capsules = link.shapes.iter().flat_map(|shape| shape.enclosing_capsules(&pose));
            capsules.map(|capsule| (index, capsule)).collect::<Vec<_>>()
        };
        links.flat_map(of_link).collect()
    }
}

impl Joint {
    fn motion(&self) -> Option<&JointMotionSpec> {
        self.motion.as_ref()
    }
}

/// Panics if a slice has another length than expected.
#[track_caller]
pub(crate) fn check_length(name: &str, got: usize, expected: usize) {
    assert_eq!(got, expected, "`{name}` has {got} elements, expected {expected}");
}

/// Rejects a name that is empty, too long or unprintable.
pub(crate) fn check_name(kind: &'static str, name: &str) -> Result<(), DescriptionError> {
    let reason = if name.is_empty() {
        "it is empty"
    } else if name.len() > MAX_NAME {
        "it has more than 200 bytes"
    } else if name.chars().any(char::is_control) {
        "it holds a control character"
    } else {
        return Ok(());
    };
    // cut, because it becomes part of a message
    let name = name.chars().take(MAX_NAME).collect();
    Err(DescriptionError::InvalidName { kind, name, reason })
}

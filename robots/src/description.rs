//! Kinematic tree of a robot: links, joints, and their poses.

use glam::{DMat3, DQuat, DVec3};

use crate::capsule::{Capsule, PlacedShape};
use crate::error::DescriptionError;
use crate::error::{finite, require};
use crate::pose::Pose;

/// Robot as a tree of links, made and validated by [`Description::read`] and
/// [`Description::from_urdf`].
///
/// A *position vector* `[dofs]` holds one number for each joint that moves and follows no other, in
/// the order of [`Description::joints`]: radians of a hinge, metres of a slide.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    pub(crate) name: String,
    pub(crate) base: Pose,
    /// Links, parents before children; the root is the first.
    pub(crate) links: Vec<Link>,
    /// Joints; joint i carries link i + 1.
    pub(crate) joints: Vec<Joint>,
    pub(crate) dofs: usize,
    pub(crate) restrictions: Vec<Restriction>,
    pub(crate) notes: Vec<String>,
    pub(crate) unread: Vec<String>,
}

/// Reduction of a free joint's range, so that a joint that follows it stays within its own range.
#[derive(Clone, Debug, PartialEq)]
pub struct Restriction {
    /// Name of the free joint.
    pub joint: String,
    /// Name of the joint that follows it.
    pub follower: String,
    /// Range in the file (radians, metres); `None` for a hinge without limits.
    pub stated: Option<[f64; 2]>,
    /// Reduced range, in which the follower stays within its own.
    pub range: [f64; 2],
}

/// Rigid body of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Name, unique among the links.
    pub name: String,
    /// Mass and inertia as in the file, which may be those of no rigid body; `None` for a frame
    /// without mass.
    pub inertia: Option<Inertia>,
    /// Collision shapes, in the link's frame.
    pub shapes: Vec<PlacedShape>,
}

/// Mass of a link, its centre and its inertia.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass in the link's frame (metres).
    pub centre: DVec3,
    /// Inertia about the centre of mass, with the link's axes (kg m^2).
    pub tensor: DMat3,
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
    pub motion: Option<Motion>,
}

/// Motion of a joint. Units are metres and newtons for a slide, radians and newton metres for a
/// hinge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Turning or sliding.
    pub kind: MotionKind,
    /// Unit vector in the joint's frame.
    pub axis: DVec3,
    /// Lowest and highest position; `None` for a joint without limits.
    pub range: Option<[f64; 2]>,
    /// Maximum speed (m/s, rad/s); `None` if the file states none.
    pub speed: Option<f64>,
    /// Maximum force or torque; `None` if the file states none.
    pub effort: Option<f64>,
    /// Viscous damping: force per speed.
    pub damping: f64,
    /// Dry friction.
    pub friction: f64,
    /// Source of the joint's position.
    pub drive: Drive,
}

/// Kind of motion: rotation about an axis, or translation along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionKind {
    /// Rotation.
    Hinge,
    /// Translation.
    Slide,
}

/// Source of a joint's position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
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

impl Motion {
    /// Returns the joint's position, given the position vector `positions`.
    pub fn position(&self, positions: &[f64]) -> f64 {
        match self.drive {
            Drive::Free { dof } => positions[dof],
            Drive::Follows { dof, multiplier, offset } => multiplier * positions[dof] + offset,
        }
    }

    /// Returns `true` if the joint's position is an element of the position vector.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self.drive, Drive::Free { .. })
    }

    /// Returns the pose of the link in the joint's frame, with the joint at `position`.
    pub(crate) fn pose(&self, position: f64) -> Pose {
        match self.kind {
            MotionKind::Slide => Pose::at(position * self.axis),
            MotionKind::Hinge => Pose {
                position: DVec3::ZERO,
                rotation: DQuat::from_axis_angle(self.axis, position),
            },
        }
    }
}

impl Description {
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

    /// Returns the index of the link `name`. The error names `asked`, which refers to the link.
    pub(crate) fn link_index(&self, name: &str, asked: &str) -> Result<usize, DescriptionError> {
        let found = self.links.iter().position(|link| link.name == name);
        found.ok_or_else(|| DescriptionError::UnknownLink {
            link: name.to_owned(),
            asked: asked.to_owned(),
            known: self.links.iter().map(|link| link.name.clone()).collect(),
        })
    }

    /// Returns the length of a position vector.
    pub fn dofs(&self) -> usize {
        self.dofs
    }

    /// Returns the joints whose positions are in a position vector, in its order.
    pub fn free_joints(&self) -> impl Iterator<Item = (&Joint, &Motion)> {
        let moving = |joint| Joint::motion(joint).map(|motion| (joint, motion));
        let joints = self.joints.iter().filter_map(moving);
        joints.filter(|(_, motion)| motion.is_free())
    }

    /// Returns the free joints whose ranges are smaller than in the file because of joints that
    /// follow them.
    pub fn restrictions(&self) -> &[Restriction] {
        &self.restrictions
    }

    /// Returns notes on values of the file that were replaced or left out, for the user.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns descriptions of the collision meshes that could not be read, whose shapes are
    /// missing from the links.
    pub fn unread_meshes(&self) -> &[String] {
        &self.unread
    }

    /// Returns the position vector of the robot at rest: for each joint zero, or the end of its
    /// range nearest to zero.
    pub fn rest(&self) -> Vec<f64> {
        let nearest = |[low, high]: [f64; 2]| 0_f64.clamp(low, high);
        let joints = self.free_joints();
        joints.map(|(_, motion)| motion.range.map_or(0.0, nearest)).collect()
    }

    /// Returns the pose of the root in the world: the identity, unless set by
    /// [`Description::placed`].
    pub fn base(&self) -> Pose {
        self.base
    }

    /// Returns this robot with its root at `base` in the world.
    ///
    /// # Errors
    /// [`DescriptionError::Number`] if `base` is not finite, or its rotation no unit quaternion.
    pub fn placed(self, base: Pose) -> Result<Self, DescriptionError> {
        let place = || format!("the base of `{}`", self.name);
        finite(place, "its position", &base.position.to_array())?;
        let length = base.rotation.length();
        let is_unit = (length - 1.0).abs() < 1e-6;
        let expected = "1, the length of a unit quaternion";
        require(is_unit, place, "the length of its rotation", length, expected)?;
        Ok(Self { base, ..self })
    }

    /// Returns this robot with the range of the free joint `joint` reduced to `range`, as for a
    /// gripper that is not opened all the way. Joints that follow it stay within their own ranges.
    ///
    /// # Errors
    /// [`DescriptionError::Number`] if `range` does not rise or is not within the joint's own, and
    /// for a joint that the robot does not have, that follows another one or has no range.
    pub fn narrowed(mut self, joint: &str, range: [f64; 2]) -> Result<Self, DescriptionError> {
        let place = format!("the joint `{joint}` of `{}`", self.name);
        let [low, high] = range;
        let found = self.joints.iter_mut().find(|found| found.name == joint);
        let motion = found.and_then(|found| found.motion.as_mut());
        let free = motion.filter(|motion| motion.is_free());
        let own = free.and_then(|motion| motion.range.as_mut());
        let refused =
            |what, value, expected| DescriptionError::Number { place, what, value, expected };
        let Some(own) = own else {
            let expected = "a position of a joint that has a range and follows no other";
            return Err(refused("the lower end of its new range", low, expected));
        };
        if !(own[0] <= low && low < own[1]) {
            let expected = "a position within its range";
            return Err(refused("the lower end of its new range", low, expected));
        }
        if !(low < high && high <= own[1]) {
            let expected = "a higher position within its range";
            return Err(refused("the upper end of its new range", high, expected));
        }
        *own = range;
        Ok(self)
    }

    /// Returns the poses of all links in the world, in the order of [`Description::links`].
    ///
    /// # Panics
    /// If `positions` is not of length [`Description::dofs`].
    pub fn poses(&self, positions: &[f64]) -> Vec<Pose> {
        check_length("positions", positions.len(), self.dofs);
        let mut poses = Vec::with_capacity(self.links.len());
        poses.push(self.base);
        // parents come before children, so the parent's pose is known already
        for joint in &self.joints {
            let moved = joint.motion().map(|motion| motion.pose(motion.position(positions)));
            poses.push(poses[joint.parent] * joint.origin * moved.unwrap_or(Pose::IDENTITY));
        }
        poses
    }

    /// Returns capsules in the world that enclose all shapes, each with the index of its link.
    /// They lack [`Description::unread_meshes`].
    ///
    /// # Panics
    /// If `positions` is not of length [`Description::dofs`].
    pub fn capsules(&self, positions: &[f64]) -> Vec<(usize, Capsule)> {
        let links = self.links.iter().zip(self.poses(positions)).enumerate();
        let of_link = |(index, (link, pose)): (usize, (&Link, Pose))| {
            let capsules = link.shapes.iter().map(move |shape| (index, shape.capsule(&pose)));
            capsules.collect::<Vec<_>>()
        };
        links.flat_map(of_link).collect()
    }
}

impl Joint {
    fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }
}

/// Panics if a slice has another length than expected.
#[track_caller]
pub(crate) fn check_length(name: &str, got: usize, expected: usize) {
    assert_eq!(got, expected, "`{name}` has {got} elements, expected {expected}");
}

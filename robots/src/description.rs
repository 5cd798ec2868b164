//! What a robot is made of: a tree of links that joints carry, and where they all are.

use glam::{DMat3, DQuat, DVec3};

use crate::capsule::{Capsule, PlacedShape};
use crate::error::DescriptionError;
use crate::error::{finite, require};
use crate::pose::Pose;

/// A robot: a tree of links. Made by [`Description::read`] and [`Description::from_urdf`], which
/// refuse what is not one.
///
/// A *position vector* `[dofs]` holds one number for each joint that moves and follows no other, in
/// the order of [`Description::joints`]: radians of a hinge, metres of a slide.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    pub(crate) name: String,
    pub(crate) base: Pose,
    /// Parents before children; the root is the first.
    pub(crate) links: Vec<Link>,
    /// Joint i carries link i + 1.
    pub(crate) joints: Vec<Joint>,
    pub(crate) dofs: usize,
    pub(crate) restrictions: Vec<Restriction>,
}

/// A free joint whose range is smaller than the file says, so that a joint that follows it stays
/// within its own range.
#[derive(Clone, Debug, PartialEq)]
pub struct Restriction {
    /// Name of the free joint.
    pub joint: String,
    /// Name of the joint that follows it.
    pub follower: String,
    /// Range that the file states (radians, metres); none for a hinge that turns without end.
    pub stated: Option<[f64; 2]>,
    /// Range in which the follower keeps to its own.
    pub range: [f64; 2],
}

/// A rigid part.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Its name, unlike that of any other link.
    pub name: String,
    /// How it resists motion; none for a frame without mass.
    pub inertia: Option<Inertia>,
    /// What it collides as, in its own frame.
    pub shapes: Vec<PlacedShape>,
}

/// Mass of a link and how it is spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Mass (kg).
    pub mass: f64,
    /// Centre of mass in the link's frame (metres).
    pub centre: DVec3,
    /// Inertia about the centre of mass, with the link's axes (kg m^2).
    pub tensor: DMat3,
}

/// What fixes a link to its parent, or lets it move.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Its name, unlike that of any other joint.
    pub name: String,
    /// Index of the link that carries it.
    pub parent: usize,
    /// The link's frame in its parent's, with the joint at zero.
    pub origin: Pose,
    /// How the link moves; none for a fixed joint.
    pub motion: Option<Motion>,
}

/// How a joint moves. Units are metres and newtons for a slide, radians and newton metres for a
/// hinge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Turning or sliding.
    pub kind: MotionKind,
    /// Unit vector in the joint's frame.
    pub axis: DVec3,
    /// Lowest and highest position; none for a hinge that turns without end.
    pub range: Option<[f64; 2]>,
    /// Highest speed (1/s).
    pub speed: f64,
    /// Highest force or torque.
    pub effort: f64,
    /// Resistance per speed.
    pub damping: f64,
    /// Dry friction.
    pub friction: f64,
    /// Where its position comes from.
    pub drive: Drive,
}

/// Turning about an axis, or sliding along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionKind {
    /// Turns.
    Hinge,
    /// Slides.
    Slide,
}

/// Where a joint's position comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// The position vector holds it.
    Free {
        /// Index in the position vector.
        dof: usize,
    },
    /// It follows another joint: URDF's `<mimic>`.
    Follows {
        /// Index of that joint in the position vector.
        dof: usize,
        /// Position per position of that joint.
        multiplier: f64,
        /// Position where that joint is at zero.
        offset: f64,
    },
}

impl Motion {
    /// The joint's position, for the position vector `positions`.
    pub fn position(&self, positions: &[f64]) -> f64 {
        match self.drive {
            Drive::Free { dof } => positions[dof],
            Drive::Follows { dof, multiplier, offset } => multiplier * positions[dof] + offset,
        }
    }

    /// Whether the position vector holds the joint's position.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self.drive, Drive::Free { .. })
    }

    /// Where a joint at `position` has its link, in the joint's frame.
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
    /// The robot's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Links, parents before children; the first is the root.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Joints; joint i carries link i + 1.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Index of the link `name`, which `asked` names.
    pub(crate) fn link_index(&self, name: &str, asked: &str) -> Result<usize, DescriptionError> {
        let found = self.links.iter().position(|link| link.name == name);
        found.ok_or_else(|| DescriptionError::UnknownLink {
            link: name.to_owned(),
            asked: asked.to_owned(),
            known: self.links.iter().map(|link| link.name.clone()).collect(),
        })
    }

    /// Length of a position vector.
    pub fn dofs(&self) -> usize {
        self.dofs
    }

    /// The joints whose positions a position vector holds, in its order.
    pub fn free_joints(&self) -> impl Iterator<Item = (&Joint, &Motion)> {
        let moving = |joint| Joint::motion(joint).map(|motion| (joint, motion));
        let joints = self.joints.iter().filter_map(moving);
        joints.filter(|(_, motion)| motion.is_free())
    }

    /// Free joints whose ranges are smaller than the file says, because joints follow them.
    pub fn restrictions(&self) -> &[Restriction] {
        &self.restrictions
    }

    /// Position vector of the robot at rest: zero, or the end of a joint's range nearest to zero.
    pub fn rest(&self) -> Vec<f64> {
        let nearest = |[low, high]: [f64; 2]| 0_f64.clamp(low, high);
        let joints = self.free_joints();
        joints.map(|(_, motion)| motion.range.map_or(0.0, nearest)).collect()
    }

    /// The root's frame in the world; the identity, unless [`Description::placed`] says otherwise.
    pub fn base(&self) -> Pose {
        self.base
    }

    /// The same robot with its root at `base` in the world.
    ///
    /// # Errors
    /// [`DescriptionError::Number`] where `base` is not finite, or its rotation no unit quaternion.
    pub fn placed(self, base: Pose) -> Result<Self, DescriptionError> {
        let place = || format!("the base of `{}`", self.name);
        finite(place, "its position", &base.position.to_array())?;
        let length = base.rotation.length();
        let is_unit = (length - 1.0).abs() < 1e-6;
        let expected = "1, as of a unit quaternion";
        require(is_unit, place, "the length of its rotation", length, expected)?;
        Ok(Self { base, ..self })
    }

    /// The same robot whose free joint `joint` moves between two positions of its range alone, as a
    /// gripper does that is not opened all the way. The positions of joints that follow it are
    /// within theirs.
    ///
    /// # Errors
    /// [`DescriptionError::Number`] where `range` does not rise or is not within the joint's own,
    /// and for a joint that the robot does not have, that follows another one or has no range.
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

    /// Frames of all links in the world, in the order of [`Description::links`].
    ///
    /// # Panics
    /// Where `positions` is not of length [`Description::dofs`].
    pub fn poses(&self, positions: &[f64]) -> Vec<Pose> {
        check_length("positions", positions.len(), self.dofs);
        let mut poses = Vec::with_capacity(self.links.len());
        poses.push(self.base);
        for joint in &self.joints {
            let moved = joint.motion().map(|motion| motion.pose(motion.position(positions)));
            poses.push(poses[joint.parent] * joint.origin * moved.unwrap_or(Pose::IDENTITY));
        }
        poses
    }

    /// Capsules that hold all shapes, in the world, each with the index of its link.
    ///
    /// # Panics
    /// As [`Description::poses`].
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

/// Refuses a slice of another length than its meaning needs.
#[track_caller]
pub(crate) fn check_length(name: &str, got: usize, expected: usize) {
    assert_eq!(got, expected, "`{name}` has {got} elements, expected {expected}");
}

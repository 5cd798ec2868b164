//! Changed copies of a robot: its base, a joint's range, an added link, other names.

use crate::capsule::{PlacedShape, Shape};
use crate::description::{Joint, Link, MAX_LINKS, MAX_SHAPES, RobotDescription, check_name};
use crate::error::{DescriptionError, MAX_NUMBER, check_numbers, require, require_count};
use crate::fit::MIN_SHAPE_SIZE;
use crate::inertia::check_inertia;
use crate::pose::{Pose, UNIT_LENGTH, is_unit_length};

impl RobotDescription {
    /// Returns this robot with its root link at `base_pose` in the world.
    ///
    /// # Errors
    /// [`DescriptionError::NumberOutOfRange`] if `base_pose` is not finite, or its rotation no unit
    /// quaternion.
    pub fn with_base_pose(self, base_pose: Pose) -> Result<Self, DescriptionError> {
        check_pose(|| format!("the base of `{}`", self.name), &base_pose)?;
        Ok(Self { base_pose, ..self })
    }

    /// Returns this robot with the range of the free joint `joint` reduced to `range`, as for a
    /// gripper that is not opened all the way. Joints that follow it stay within their own ranges.
    ///
    /// # Errors
    /// [`DescriptionError::NumberOutOfRange`] if `range` does not rise or is not within the joint's
    /// own, and for a joint that the robot does not have, that follows another one or has no range.
    pub fn with_joint_range(
        mut self,
        joint: &str,
        range: [f64; 2],
    ) -> Result<Self, DescriptionError> {
        let place = format!("the joint `{joint}` of `{}`", self.name);
        let [low, high] = range;
        let found = self.joints.iter_mut().find(|found| found.name == joint);
        let motion = found.and_then(|found| found.motion.as_mut());
        let free = motion.filter(|motion| motion.is_free());
        let own = free.and_then(|free_motion| free_motion.range.as_mut());
        let refused = |what, value, expected| DescriptionError::NumberOutOfRange {
            place,
            what,
            value,
            expected,
        };
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

    /// Returns this robot with the new link `link`, fixed to its link `parent` at the pose `origin`
    /// in the parent's frame. The joint has the name of the link.
    ///
    /// Mass, inertia and shapes are held to the rules for a URDF whose robot is simulated. An
    /// inertia with a mass below a milligram plays no part, so only its numbers are checked.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`], [`DescriptionError::Duplicate`],
    /// [`DescriptionError::InvalidName`], [`DescriptionError::NumberOutOfRange`] for poses, mass,
    /// inertia and sizes, [`DescriptionError::InvalidInertia`] for an inertia that no rigid body
    /// has, [`DescriptionError::CountOutOfRange`] for more than [`MAX_LINKS`] links or 1000 shapes.
    pub fn with_fixed_link(
        mut self,
        parent: &str,
        origin: Pose,
        link: Link,
    ) -> Result<Self, DescriptionError> {
        let parent = self.link_index(parent, "a link that is added")?;
        let name = link.name.clone();
        for (kind, taken) in [
            ("link", self.links.iter().any(|own| own.name == name)),
            ("joint", self.joints.iter().any(|own| own.name == name)),
        ] {
            if taken {
                return Err(DescriptionError::Duplicate { kind, name });
            }
        }
        check_pose(|| format!("the link `{name}`"), &origin)?;
        check_link(&link)?;
        let place = || format!("the robot `{}`", self.name);
        require_count(place, "link", self.links.len() + 1, 1..=MAX_LINKS)?;
        // right after its parent, which keeps links in depth-first order
        for joint in self.joints.iter_mut().filter(|joint| joint.parent > parent) {
            joint.parent += 1;
        }
        self.links.insert(parent + 1, link);
        self.joints.insert(parent, Joint { name, parent, origin, motion: None });
        Ok(self)
    }

    /// Returns this robot with `prefix` before the names of all links and joints, to tell them from
    /// the names of a scene.
    ///
    /// # Errors
    /// [`DescriptionError::InvalidName`] for a prefix with control characters, or one that makes a
    /// name longer than 200 bytes.
    pub fn with_prefix(mut self, prefix: &str) -> Result<Self, DescriptionError> {
        let links = self.links.iter_mut().map(|link| ("link", &mut link.name));
        let joints = self.joints.iter_mut().map(|joint| ("joint", &mut joint.name));
        links.chain(joints).try_for_each(|(kind, name)| {
            name.insert_str(0, prefix);
            check_name(kind, name)
        })?;
        for restriction in &mut self.restrictions {
            restriction.joint.insert_str(0, prefix);
            restriction.follower.insert_str(0, prefix);
        }
        Ok(self)
    }
}

/// Rejects a link that a URDF could not hold, or whose mass and shapes could not be simulated.
fn check_link(link: &Link) -> Result<(), DescriptionError> {
    let name = &link.name;
    check_name("link", name)?;
    link.inertia.map_or(Ok(()), |inertia| check_inertia(name, &inertia))?;
    let place = || format!("the link `{name}`");
    require_count(place, "collision shape", link.shapes.len(), 0..=MAX_SHAPES)?;
    link.shapes.iter().enumerate().try_for_each(|(index, shape)| {
        check_shape(|| format!("the collision shape {index} of the link `{name}`"), shape)
    })
}

/// Rejects a shape at an impossible pose, and sizes that are not those of a URDF's shapes.
fn check_shape(place: impl Fn() -> String, placed: &PlacedShape) -> Result<(), DescriptionError> {
    check_pose(&place, &placed.pose)?;
    let sizes = match placed.shape {
        Shape::Sphere { radius } => vec![radius],
        Shape::Capsule { radius, length } | Shape::Cylinder { radius, length } => {
            vec![radius, length]
        }
        Shape::Box { half_extents } => (2.0 * half_extents).to_array().to_vec(),
        // only reading a mesh makes one
        Shape::Hull(_) => Vec::new(),
    };
    sizes.into_iter().try_for_each(|size| {
        let in_range = (MIN_SHAPE_SIZE..=MAX_NUMBER).contains(&size);
        require(in_range, &place, "its size", size, "1e-6 to 1e6 metres")
    })
}

/// Rejects a pose with large or non-finite numbers, or whose rotation is no unit quaternion.
fn check_pose(place: impl Fn() -> String, pose: &Pose) -> Result<(), DescriptionError> {
    check_numbers(&place, "its position", &pose.position.to_array())?;
    let length = pose.rotation.length();
    let what = "the length of its rotation";
    require(is_unit_length(length), place, what, length, UNIT_LENGTH)
}

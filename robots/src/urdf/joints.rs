//! Joints of a URDF: kinds, axes, limits, and mimics.

use glam::DVec3;
use urdf_rs::JointType;

use super::origin;
use super::tree::Tree;
use crate::description::{Joint, JointMotion, MotionKind, PositionSource};
use crate::error::DescriptionError;
use crate::error::{check_numbers, require};

/// Length of the shortest axis that is accepted.
const SHORTEST_AXIS: f64 = 1e-6;

/// Converts the joints, in the tree's order. Returns them with the number of free joints.
pub(super) fn joints(
    file: &urdf_rs::Robot,
    tree: &Tree,
) -> Result<(Vec<Joint>, usize), DescriptionError> {
    let in_order = || tree.joints.iter().map(|&index| &file.joints[index]);
    let free: Vec<&str> = in_order().filter(|joint| is_free(joint)).map(|j| &j.name[..]).collect();
    let joint = |(stated, &parent): (&urdf_rs::Joint, &usize)| {
        Ok(Joint {
            name: stated.name.clone(),
            parent,
            origin: origin(|| place(stated), &stated.origin)?,
            motion: motion(stated, &free)?,
        })
    };
    let joints = in_order().zip(&tree.parents).map(joint);
    Ok((joints.collect::<Result<_, _>>()?, free.len()))
}

fn is_free(joint: &urdf_rs::Joint) -> bool {
    joint.joint_type != JointType::Fixed && joint.mimic.is_none()
}

fn place(joint: &urdf_rs::Joint) -> String {
    format!("joint `{}`", joint.name)
}

fn motion(joint: &urdf_rs::Joint, free: &[&str]) -> Result<Option<JointMotion>, DescriptionError> {
    let Some((kind, limited)) = kind(joint)? else {
        return Ok(None);
    };
    let drive = drive(joint, free)?;
    let [max_speed, max_effort] = strength(joint, &drive)?;
    let [damping, friction] = resistance(joint)?;
    let range = if limited { Some(range(joint)?) } else { None };
    Ok(Some(JointMotion {
        kind,
        axis: axis(joint)?,
        range,
        max_speed,
        max_effort,
        damping,
        friction,
        drive,
    }))
}

/// Returns the kind of motion, and `true` if the joint has limits. `None` for a fixed joint.
fn kind(joint: &urdf_rs::Joint) -> Result<Option<(MotionKind, bool)>, DescriptionError> {
    let kind = match joint.joint_type {
        JointType::Fixed => return Ok(None),
        JointType::Revolute => return Ok(Some((MotionKind::Hinge, true))),
        JointType::Continuous => return Ok(Some((MotionKind::Hinge, false))),
        JointType::Prismatic => return Ok(Some((MotionKind::Slide, true))),
        JointType::Floating => "floating",
        JointType::Planar => "planar",
        JointType::Spherical => "spherical",
    };
    let joint = joint.name.clone();
    Err(DescriptionError::UnsupportedJointKind { joint, kind })
}

fn axis(joint: &urdf_rs::Joint) -> Result<DVec3, DescriptionError> {
    let place = || place(joint);
    check_numbers(place, "the axis", &*joint.axis.xyz)?;
    let axis = DVec3::from_array(*joint.axis.xyz);
    let (length, expected) = (axis.length(), "a direction");
    require(length > SHORTEST_AXIS, place, "the axis's length", length, expected)?;
    Ok(axis / length)
}

fn range(joint: &urdf_rs::Joint) -> Result<[f64; 2], DescriptionError> {
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    check_numbers(|| place(joint), "a limit", &[lower, upper])?;
    if lower < upper {
        return Ok([lower, upper]);
    }
    Err(DescriptionError::InvalidLimits { joint: joint.name.clone(), lower, upper })
}

/// Reads the maximum speed and effort, which must be positive unless the joint follows another one.
fn strength(joint: &urdf_rs::Joint, drive: &PositionSource) -> Result<[f64; 2], DescriptionError> {
    let (speed, effort) = (joint.limit.velocity, joint.limit.effort);
    let place = || place(joint);
    let what = "the limit's velocity or effort";
    check_numbers(place, what, &[speed, effort])?;
    let follows = matches!(drive, PositionSource::Follows { .. });
    let expected = "a positive number in `<limit>`";
    for (limit, value) in [("the limit's velocity", speed), ("the limit's effort", effort)] {
        require(follows || value > 0.0, place, limit, value, expected)?;
    }
    Ok([speed, effort])
}

fn resistance(joint: &urdf_rs::Joint) -> Result<[f64; 2], DescriptionError> {
    let stated = joint.dynamics.as_ref();
    let resistance = stated.map_or([0.0; 2], |stated| [stated.damping, stated.friction]);
    let least = resistance[0].min(resistance[1]);
    let what = "damping or friction";
    check_numbers(|| place(joint), what, &resistance)?;
    require(least >= 0.0, || place(joint), what, least, "zero or more")?;
    Ok(resistance)
}

/// Returns the source of the joint's position; `free` are the names of the free joints, in order.
fn drive(joint: &urdf_rs::Joint, free: &[&str]) -> Result<PositionSource, DescriptionError> {
    let dof = |name: &str| free.iter().position(|free| *free == name);
    let Some(mimic) = &joint.mimic else {
        let own = dof(&joint.name).map(|dof| PositionSource::Free { dof });
        return own.ok_or_else(|| unknown(joint, &joint.name));
    };
    let (multiplier, offset) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
    check_numbers(|| place(joint), "the mimic's multiplier or offset", &[multiplier, offset])?;
    let followed = dof(&mimic.joint).ok_or_else(|| unknown(joint, &mimic.joint))?;
    Ok(PositionSource::Follows { dof: followed, multiplier, offset })
}

fn unknown(joint: &urdf_rs::Joint, followed: &str) -> DescriptionError {
    DescriptionError::InvalidMimic {
        joint: joint.name.clone(),
        followed: followed.to_owned(),
        reason: "it must name a joint that moves and follows no other",
    }
}

//! Joints of a URDF: kinds, axes, limits, and joints that follow others.

use std::collections::HashMap;

use glam::DVec3;
use urdf_rs::{JointType, Mimic};

use super::links::pose;
use super::tree::Tree;
use super::{Report, UrdfSettings};
use crate::description::{Joint, JointMotionKind, JointMotionSpec, JointPositionSource};
use crate::error::{DescriptionError, MAX_NUMBER};

/// Converts the joints of a URDF, in the tree's order, and looks up the joints that others follow.
/// Returns the joints with the number of free ones. `lines` are those of the joints.
pub(super) fn joints(
    file: &urdf_rs::Robot,
    tree: &Tree,
    lines: &[usize],
    settings: &UrdfSettings,
    report: &mut Report,
) -> (Vec<Joint>, usize) {
    let stated: Vec<_> = tree.joints.iter().map(|&index| &file.joints[index]).collect();
    let mut joints = Vec::new();
    // positions of the joints that do not move
    let mut locked = vec![0.0; stated.len()];
    let mut num_dofs = 0;
    for (index, (of_file, &parent)) in stated.iter().zip(&tree.parents).enumerate() {
        let (name, origin) = (of_file.name.clone(), pose(&of_file.origin));
        let motion = motion(of_file, settings, lines[index], report);
        let mut joint = Joint { name, parent, origin, motion };
        if let (Some(own), None) = (&mut joint.motion, mimic(of_file)) {
            if let Some([position, _]) = own.range.filter(|[lower, upper]| lower == upper) {
                locked[index] = position;
                let reason = "its `lower` and `upper` are equal (0 where the file states none)";
                lock(&mut joint, position, reason, lines[index], report);
            } else {
                own.drive = JointPositionSource::Free { dof: num_dofs };
                num_dofs += 1;
            }
        }
        joints.push(joint);
    }
    let names = stated.iter().enumerate();
    let index: HashMap<&str, usize> = names.map(|(i, joint)| (&joint.name[..], i)).collect();
    for (follower, followed) in stated.iter().enumerate().filter_map(|(i, j)| Some((i, mimic(j)?)))
    {
        let line = lines[follower];
        match leader(&stated, &index, follower) {
            Ok((leader, multiplier, offset)) => match joints[leader].motion {
                Some(JointMotionSpec { drive: JointPositionSource::Free { dof }, .. }) => {
                    let drive = JointPositionSource::Follows { dof, multiplier, offset };
                    let motion = joints[follower].motion.as_mut();
                    motion.into_iter().for_each(|motion| motion.drive = drive);
                }
                _ => {
                    let position = offset + multiplier * locked[leader];
                    let reason = "it follows a joint that does not move";
                    lock(&mut joints[follower], position, reason, line, report);
                }
            },
            Err(reason) => {
                let (joint, followed) = (joints[follower].name.clone(), followed.joint.clone());
                report.reject(line, DescriptionError::InvalidMimic { joint, followed, reason });
            }
        }
    }
    (joints, num_dofs)
}

fn lock(joint: &mut Joint, position: f64, reason: &str, line: usize, report: &mut Report) {
    if let Some(motion) = joint.motion.take() {
        joint.origin = joint.origin * motion.pose(position);
        let name = &joint.name;
        report.note(line, &format!("the joint `{name}`: {reason}, so it is fixed at {position}"));
    }
}

/// Returns the `<mimic>` of a joint, unless it was reported because it names no joint.
fn mimic(joint: &urdf_rs::Joint) -> Option<&Mimic> {
    joint.mimic.as_ref().filter(|mimic| !mimic.joint.is_empty())
}

/// Returns the joint that `joint` follows over any number of others, with the multiplier and offset
/// that come of them all.
fn leader(
    joints: &[&urdf_rs::Joint],
    index: &HashMap<&str, usize>,
    joint: usize,
) -> Result<(usize, f64, f64), &'static str> {
    let (mut leader, mut multiplier, mut offset) = (joint, 1.0, 0.0);
    for _ in 0..=joints.len() {
        let Some(mimic) = mimic(joints[leader]) else {
            return Ok((leader, multiplier, offset));
        };
        offset += multiplier * mimic.offset.unwrap_or(0.0);
        multiplier *= mimic.multiplier.unwrap_or(1.0);
        let next = index.get(&mimic.joint[..]);
        leader = *next.ok_or("there is no joint of that name, or of one that it follows")?;
        if offset.abs().max(multiplier.abs()) > MAX_NUMBER {
            return Err("all multipliers and offsets together come to more than 1e6");
        }
    }
    Err("in the end it follows itself")
}

/// Smallest speed (rad/s, m/s) or effort (newton metres, newtons) that limits a joint.
const MIN_LIMIT: f64 = 1e-6;

/// Converts the motion of a joint, for the present as if it followed no other, with default limits
/// of free joints. `None` for a fixed joint.
fn motion(
    joint: &urdf_rs::Joint,
    settings: &UrdfSettings,
    line: usize,
    report: &mut Report,
) -> Option<JointMotionSpec> {
    let (kind, limited) = match joint.joint_type {
        JointType::Revolute => (JointMotionKind::Hinge, true),
        JointType::Continuous => (JointMotionKind::Hinge, false),
        JointType::Prismatic => (JointMotionKind::Slide, true),
        // the cleaned file holds no other kinds
        _ => return None,
    };
    let limit = &joint.limit;
    // limits of 1e6 and more stand for none
    let endless = limit.lower <= -MAX_NUMBER && limit.upper >= MAX_NUMBER;
    // subnormal numbers are written as zero, and ends may become equal by that
    let end = |end: f64| if end.is_subnormal() { 0.0 } else { end.clamp(-MAX_NUMBER, MAX_NUMBER) };
    let range = [limit.lower, limit.upper].map(end);
    let mut maximum = |name: &str, stated: f64, default: Option<f64>| {
        if stated > 0.0 && stated < MIN_LIMIT {
            let note = format!("states a limit of {name} of {stated:e}, too small to be used");
            report.note(line, &format!("the joint `{}` {note}", joint.name));
        }
        let stated = Some(stated).filter(|&stated| is_limit(stated));
        let default = default.filter(|_| stated.is_none() && joint.mimic.is_none());
        if let Some(default) = default {
            let note = format!("has no limit of {name}, so {default} is assumed");
            report.note(line, &format!("the joint `{}` {note}", joint.name));
        }
        stated.or(default)
    };
    let dynamics = joint.dynamics.clone().unwrap_or_default();
    Some(JointMotionSpec {
        kind,
        axis: DVec3::from_array(*joint.axis.xyz).normalize(),
        range: (limited && !endless).then_some(range),
        max_speed: maximum("velocity", limit.velocity, settings.default_speed),
        max_effort: maximum("effort", limit.effort, settings.default_effort),
        damping: dynamics.damping,
        friction: dynamics.friction,
        drive: JointPositionSource::Free { dof: 0 },
    })
}

/// Returns `true` if a speed or effort limits a joint: many files write zero or 1e6 for unknown, and
/// MuJoCo refuses a servo whose greatest force rounds to zero.
pub(super) fn is_limit(value: f64) -> bool {
    (MIN_LIMIT..MAX_NUMBER).contains(&value)
}

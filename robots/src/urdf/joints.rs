//! Joints of a URDF: kinds, axes, limits, and joints that follow others.

use std::collections::HashMap;

use glam::DVec3;

use super::Report;
use super::UrdfSettings;
use super::tree::Tree;
use super::xml::{Element, Found};
use crate::description::{Drive, Joint, Motion, MotionKind};
use crate::error::{DescriptionError, LARGEST};
use crate::pose::Pose;

/// Length of the shortest axis that is accepted.
const SHORTEST_AXIS: f64 = 1e-6;

/// Joint as the file states it, before links and other joints are looked up.
pub(super) struct StatedJoint<'a> {
    pub(super) element: Element<'a>,
    pub(super) parent: Option<&'a str>,
    pub(super) child: Option<&'a str>,
    origin: Pose,
    /// Motion, for the present as if the joint followed no other.
    motion: Option<Motion>,
    mimic: Option<Mimic<'a>>,
    /// Position at which a joint that does not move is locked.
    locked: f64,
}

struct Mimic<'a> {
    followed: &'a str,
    multiplier: f64,
    offset: f64,
}

impl<'a> StatedJoint<'a> {
    pub(super) fn new(joint: Element<'a>, settings: &UrdfSettings, report: &mut Report) -> Self {
        let [parent, child] =
            ["parent", "child"].map(|child| report.keep(joint.text_of_child([child, "link"])));
        let mut stated = Self {
            element: joint,
            parent,
            child,
            origin: report.keep(joint.origin()).unwrap_or(Pose::IDENTITY),
            motion: report.keep(motion(joint)).flatten(),
            mimic: None,
            locked: 0.0,
        };
        let Some(motion) = &mut stated.motion else {
            return stated;
        };
        stated.mimic = joint.child("mimic").and_then(|mimic| report.keep(read_mimic(mimic)));
        let single = motion.range.filter(|[lower, upper]| lower == upper);
        match (single, stated.mimic.is_some()) {
            (Some([position, _]), false) => {
                stated.lock(position, "its `lower` equals its `upper`", report);
            }
            (Some(_), true) => {
                report.note(joint, "its range is a single position, so only `<mimic>` limits it");
                motion.range = None;
            }
            (None, false) => fill_in(joint, motion, settings, report),
            (None, true) => (),
        }
        stated
    }

    /// Fixes the joint at a position.
    fn lock(&mut self, position: f64, reason: &str, report: &mut Report) {
        if let Some(motion) = self.motion.take() {
            report.note(self.element, &format!("{reason}, so it is fixed at {position}"));
            self.origin = self.origin * motion.pose(position);
            self.locked = position;
        }
    }
}

/// Puts the joints into the tree's order and looks up followed joints. Returns the joints with the
/// number of free ones.
pub(super) fn resolve(
    stated: Vec<StatedJoint>,
    tree: &Tree,
    report: &mut Report,
) -> (Vec<Joint>, usize) {
    let mut in_file: Vec<_> = stated.into_iter().map(Some).collect();
    let mut stated: Vec<_> = tree.joints.iter().filter_map(|&at| in_file[at].take()).collect();
    let names = stated.iter().enumerate();
    let index: HashMap<&str, usize> = names.map(|(i, joint)| (joint.element.name(), i)).collect();
    let mut dofs = 0;
    let mut own = Vec::new();
    for joint in &stated {
        let is_free = joint.motion.is_some() && joint.mimic.is_none();
        own.push(is_free.then_some(dofs));
        dofs += usize::from(is_free);
    }
    for joint in 0..stated.len() {
        let Some((leader, [multiplier, offset])) = report.keep(leader(&stated, &index, joint))
        else {
            continue;
        };
        let position = offset + multiplier * stated[leader].locked;
        match (own[leader], &mut stated[joint].motion) {
            (Some(dof), Some(motion)) if leader != joint => {
                motion.drive = Drive::Follows { dof, multiplier, offset };
            }
            (Some(dof), Some(motion)) => motion.drive = Drive::Free { dof },
            _ => stated[joint].lock(position, "it follows a joint that does not move", report),
        }
    }
    let joints = stated.into_iter().zip(&tree.parents);
    let joint = |(stated, &parent): (StatedJoint, &usize)| Joint {
        name: stated.element.name().to_owned(),
        parent,
        origin: stated.origin,
        motion: stated.motion,
    };
    (joints.map(joint).collect(), dofs)
}

/// Returns the joint that `joint` follows over any number of others, or itself, with the multiplier
/// and offset that come of them all.
fn leader(
    joints: &[StatedJoint],
    index: &HashMap<&str, usize>,
    joint: usize,
) -> Found<(usize, [f64; 2])> {
    let refused = |reason| {
        let StatedJoint { element, mimic, .. } = &joints[joint];
        let followed = mimic.as_ref().map_or("", |mimic| mimic.followed).to_owned();
        let joint = element.name().to_owned();
        Err(element.at(DescriptionError::Mimic { joint, followed, reason }))
    };
    let (mut leader, mut multiplier, mut offset) = (joint, 1.0, 0.0);
    for _ in 0..=joints.len() {
        let Some(mimic) = &joints[leader].mimic else {
            return Ok((leader, [multiplier, offset]));
        };
        offset += multiplier * mimic.offset;
        multiplier *= mimic.multiplier;
        let Some(&next) = index.get(mimic.followed) else {
            return refused("there is no joint of that name, or of one that it follows");
        };
        if offset.abs().max(multiplier.abs()) > LARGEST {
            return refused("all multipliers and offsets together come to more than 1e6");
        }
        leader = next;
    }
    refused("in the end it follows itself")
}

fn read_mimic(mimic: Element<'_>) -> Found<Mimic<'_>> {
    Ok(Mimic {
        followed: mimic.text("joint").ok_or_else(|| mimic.missing("`joint`"))?,
        multiplier: mimic.number("multiplier", 1.0)?,
        offset: mimic.number("offset", 0.0)?,
    })
}

/// Reads the motion of a joint. `None` for a fixed joint.
fn motion(joint: Element) -> Found<Option<Motion>> {
    let kind = joint.text("type").ok_or_else(|| joint.missing("`type`"))?;
    let (kind, limited) = match kind {
        "fixed" => return Ok(None),
        "revolute" => (MotionKind::Hinge, true),
        "continuous" => (MotionKind::Hinge, false),
        "prismatic" => (MotionKind::Slide, true),
        _ => return Err(joint.refused("type", "revolute, continuous, prismatic or fixed")),
    };
    let limit = joint.child("limit");
    let range = match limit {
        Some(limit) if limited => range(limit)?,
        None if limited => {
            return Err(joint.missing("`<limit>` with `lower` and `upper` (or is continuous)"));
        }
        _ => None,
    };
    let strength = |name| limit.map_or(Ok(None), |limit| strength(limit, name));
    let dynamics = joint.child("dynamics");
    Ok(Some(Motion {
        kind,
        axis: axis(joint)?,
        range,
        speed: strength("velocity")?,
        effort: strength("effort")?,
        damping: resistance(dynamics, "damping")?,
        friction: resistance(dynamics, "friction")?,
        drive: Drive::Free { dof: 0 },
    }))
}

fn axis(joint: Element) -> Found<DVec3> {
    let Some(stated) = joint.child("axis") else {
        return Ok(DVec3::X);
    };
    let axis = stated.vector("xyz", DVec3::X)?;
    let length = axis.length();
    stated.require(length > SHORTEST_AXIS, "xyz", "a direction")?;
    Ok(axis / length)
}

/// Reads the range of a joint. `None` if both ends are 1e6 or more, which stand for none.
fn range(limit: Element) -> Found<Option<[f64; 2]>> {
    let [lower, upper] = ["lower", "upper"].map(|name| limit.any_number(name));
    let [lower, upper] = [lower?, upper?].map(|end| end.unwrap_or(0.0));
    limit.require(lower <= upper, "lower", "a position not above `upper`")?;
    let endless = lower <= -LARGEST && upper >= LARGEST;
    Ok((!endless).then(|| [lower, upper].map(|end| end.clamp(-LARGEST, LARGEST))))
}

/// Reads a maximum speed or effort. `None` for zero, negative numbers and 1e6 or more, which all
/// stand for none in some files.
fn strength(limit: Element, name: &'static str) -> Found<Option<f64>> {
    let value = limit.any_number(name)?;
    Ok(value.filter(|value| *value > 0.0 && *value < LARGEST))
}

fn resistance(dynamics: Option<Element>, name: &'static str) -> Found<f64> {
    let Some(dynamics) = dynamics else {
        return Ok(0.0);
    };
    let resistance = dynamics.number(name, 0.0)?;
    dynamics.require(resistance >= 0.0, name, "zero or more")?;
    Ok(resistance)
}

/// Gives a joint the speed and effort that the file does not state.
fn fill_in(joint: Element, motion: &mut Motion, settings: &UrdfSettings, report: &mut Report) {
    let UrdfSettings { speed, effort, .. } = settings;
    for (name, stated, missing) in
        [("velocity", &mut motion.speed, speed), ("effort", &mut motion.effort, effort)]
    {
        if let (None, Some(assumed)) = (&stated, missing) {
            report.note(joint, &format!("it has no limit of {name}, so {assumed} is assumed"));
            *stated = Some(*assumed);
        }
    }
}

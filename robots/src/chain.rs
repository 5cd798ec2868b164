//! The joints between a robot's base and a tip: forward kinematics and the Jacobian.

use crate::description::{Description, Drive, Motion, MotionKind, check_length};
use crate::error::DescriptionError;
use crate::pose::Pose;
use crate::twist::Twist;

/// The free joints between a robot's base and one of its links, the *tip*.
///
/// A *configuration* `[len]` holds the positions of these joints, from the base to the tip: radians
/// of a hinge, metres of a slide. All frames are in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    joints: Vec<ChainJoint>,
    /// The tip in the frame of the last joint.
    tip: Pose,
}

/// A joint of a chain.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainJoint {
    /// Its name.
    pub name: String,
    /// Index in the position vectors of the [`Description`].
    pub dof: usize,
    /// How it moves.
    pub motion: Motion,
    /// Its frame in that of the joint before it; of the first one, in the world.
    before: Pose,
}

impl Chain {
    /// The joints that lead to the link `tip`.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`]; [`DescriptionError::Chain`] where no joint leads there,
    /// or one that follows another.
    pub fn new(description: &Description, tip: &str) -> Result<Self, DescriptionError> {
        let mut joints = Vec::new();
        let mut pose = description.base();
        for index in way(description, tip)? {
            let joint = &description.joints()[index];
            pose = pose * joint.origin;
            let Some(motion) = joint.motion else {
                continue;
            };
            let dof = dof(&motion, tip, &joint.name)?;
            joints.push(ChainJoint { name: joint.name.clone(), dof, motion, before: pose });
            pose = Pose::IDENTITY;
        }
        if joints.is_empty() {
            return Err(refused(tip, "no joint on it moves".to_owned()));
        }
        Ok(Self { joints, tip: pose })
    }

    /// The joints, from the base to the tip.
    pub fn joints(&self) -> &[ChainJoint] {
        &self.joints
    }

    /// Frame of the tip.
    ///
    /// # Panics
    /// Where `configuration` is not as long as the chain.
    pub fn tip(&self, configuration: &[f64]) -> Pose {
        check_length("configuration", configuration.len(), self.joints.len());
        let joints = self.joints.iter().zip(configuration);
        let frame = |pose: Pose, (joint, &position): (&ChainJoint, &f64)| {
            pose * joint.before * joint.motion.pose(position)
        };
        joints.fold(Pose::IDENTITY, frame) * self.tip
    }

    /// The geometric Jacobian: into `columns` `[len]`, the twist of the tip per unit of each
    /// joint's velocity (Siciliano, Sciavicco, Villani, Oriolo 2009, "Robotics", section 3.1).
    /// Returns the frame of the tip.
    ///
    /// # Panics
    /// Where a slice is not as long as the chain.
    pub fn jacobian(&self, configuration: &[f64], columns: &mut [Twist]) -> Pose {
        check_length("columns", columns.len(), self.joints.len());
        let tip = self.tip(configuration);
        let mut pose = Pose::IDENTITY;
        for ((joint, &position), column) in self.joints.iter().zip(configuration).zip(columns) {
            pose = pose * joint.before;
            let axis = pose.rotation * joint.motion.axis;
            *column = match joint.motion.kind {
                MotionKind::Slide => Twist::moving(axis),
                MotionKind::Hinge => {
                    Twist { linear: axis.cross(tip.position - pose.position), angular: axis }
                }
            };
            pose = pose * joint.motion.pose(position);
        }
        tip
    }

    /// The chain's part of a position vector of the [`Description`].
    ///
    /// # Panics
    /// Where `positions` is too short.
    pub fn configuration(&self, positions: &[f64]) -> Vec<f64> {
        self.joints.iter().map(|joint| positions[joint.dof]).collect()
    }
}

/// Indices of the joints from the base to the link `tip`.
fn way(description: &Description, tip: &str) -> Result<Vec<usize>, DescriptionError> {
    let mut link = description.link_index(tip, "a chain")?;
    let mut way = Vec::new();
    while let Some(joint) = link.checked_sub(1) {
        way.push(joint);
        link = description.joints()[joint].parent;
    }
    way.reverse();
    Ok(way)
}

fn dof(motion: &Motion, tip: &str, joint: &str) -> Result<usize, DescriptionError> {
    let Drive::Free { dof } = motion.drive else {
        let reason = format!("the joint `{joint}` on it follows another joint");
        return Err(refused(tip, reason));
    };
    Ok(dof)
}

fn refused(tip: &str, reason: String) -> DescriptionError {
    let tip = tip.to_owned();
    DescriptionError::Chain { tip, reason }
}

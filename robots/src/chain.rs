//! Serial chain of joints from a robot's base to a tip: forward kinematics and the Jacobian.

use glam::DVec3;

use crate::description::{
    JointMotionKind, JointMotionSpec, JointPositionSource, RobotDescription, check_length,
};
use crate::error::DescriptionError;
use crate::pose::Pose;
use crate::twist::Twist;

/// Serial chain of the free joints between a robot's base and one of its links, the *tip*.
///
/// A *configuration* `[len]` holds the positions of these joints, from the base to the tip: radians
/// of a hinge, metres of a slide. All frames are in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    joints: Vec<ChainJoint>,
    /// Pose of the tip in the frame of the last joint.
    tip: Pose,
}

/// Free joint of a [`Chain`], with its motion and its index in position vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainJoint {
    /// Name of the joint.
    pub name: String,
    /// Index in the position vectors of the [`RobotDescription`].
    pub dof_index: usize,
    /// Kind, axis and limits of the joint's motion.
    pub motion: JointMotionSpec,
    /// Pose in the frame of the preceding joint; for the first joint, in the world.
    before: Pose,
}

impl Chain {
    /// Builds the chain from the base to the link `tip`.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`]; [`DescriptionError::InvalidChain`] if no joint on the
    /// path moves, or if one of them follows another joint.
    pub fn new(description: &RobotDescription, tip: &str) -> Result<Self, DescriptionError> {
        let mut joints = Vec::new();
        let mut pose = description.base_pose();
        for index in path_to(description, tip)? {
            let joint = &description.joints()[index];
            // fixed joints are merged into the pose of the next joint that moves
            pose = pose * joint.origin;
            let Some(motion) = joint.motion else {
                continue;
            };
            let dof = dof(&motion, tip, &joint.name)?;
            joints.push(ChainJoint {
                name: joint.name.clone(),
                dof_index: dof,
                motion,
                before: pose,
            });
            pose = Pose::IDENTITY;
        }
        if joints.is_empty() {
            return Err(chain_error(tip, "no joint on it moves".to_owned()));
        }
        Ok(Self { joints, tip: pose })
    }

    /// Returns the joints, from the base to the tip.
    pub fn joints(&self) -> &[ChainJoint] {
        &self.joints
    }

    /// Returns the pose of the tip in the world (forward kinematics).
    ///
    /// # Panics
    /// If `configuration` is not as long as the chain.
    pub fn tip_pose(&self, configuration: &[f64]) -> Pose {
        check_length("configuration", configuration.len(), self.joints.len());
        let joints = self.joints.iter().zip(configuration);
        let frame = |pose: Pose, (joint, &position): (&ChainJoint, &f64)| {
            pose * joint.before * joint.motion.pose(position)
        };
        joints.fold(Pose::IDENTITY, frame) * self.tip
    }

    /// Writes the geometric Jacobian in `configuration` into `columns` and returns the pose of the
    /// tip.
    ///
    /// Writes the twist of the tip per unit of each joint's velocity into `columns` `[len]`
    /// (Siciliano, Sciavicco, Villani, Oriolo 2009, "Robotics", section 3.1).
    ///
    /// # Panics
    /// If a slice is not as long as the chain.
    pub fn jacobian(&self, configuration: &[f64], columns: &mut [Twist]) -> Pose {
        check_length("columns", columns.len(), self.joints.len());
        let tip = self.tip_pose(configuration);
        let mut pose = Pose::IDENTITY;
        for ((joint, &position), column) in self.joints.iter().zip(configuration).zip(columns) {
            pose = pose * joint.before;
            let axis = pose.rotation * joint.motion.axis;
            *column = match joint.motion.kind {
                JointMotionKind::Slide => Twist::from_linear(axis),
                JointMotionKind::Hinge => {
                    Twist { linear: axis.cross(tip.position - pose.position), angular: axis }
                }
            };
            pose = pose * joint.motion.pose(position);
        }
        tip
    }

    /// Returns a point in the world, and a bound on the distance (metres) of the last joint's frame
    /// from it in any configuration. The point is on the axis of the first joint, if that turns.
    pub(crate) fn reach_bound(&self) -> (DVec3, f64) {
        let mut base = self.joints[0].before;
        let mut links: Vec<DVec3> =
            self.joints[1..].iter().map(|joint| joint.before.position).collect();
        if let (JointMotionSpec { kind: JointMotionKind::Hinge, axis, .. }, Some(link)) =
            (self.joints[0].motion, links.first_mut())
        {
            // turning about the axis keeps the distance from each of its points
            let along = link.dot(axis) * axis;
            base.position = base.transform_point(along);
            *link -= along;
        }
        let slides = self.joints.iter().filter(|of| of.motion.kind == JointMotionKind::Slide);
        let travel = slides.map(|of| match of.motion.range {
            Some([low, high]) => low.abs().max(high.abs()),
            None => f64::INFINITY,
        });
        let reach = links.iter().map(|link| link.length()).sum::<f64>() + travel.sum::<f64>();
        (base.position, reach)
    }

    /// Returns the pose of the tip in the frame of the last joint.
    pub(crate) fn tip_in_last_joint(&self) -> Pose {
        self.tip
    }

    /// Picks the chain's configuration `[len]` from a position vector of the [`RobotDescription`].
    ///
    /// # Panics
    /// If `positions` is too short.
    pub fn extract_configuration(&self, positions: &[f64]) -> Vec<f64> {
        self.joints.iter().map(|joint| positions[joint.dof_index]).collect()
    }
}

/// Returns the indices of the joints from the base to the link `tip`.
fn path_to(description: &RobotDescription, tip: &str) -> Result<Vec<usize>, DescriptionError> {
    let mut link = description.link_index(tip, "a chain")?;
    let mut path = Vec::new();
    // joint i carries link i + 1, and no joint carries the root
    while let Some(joint) = link.checked_sub(1) {
        path.push(joint);
        link = description.joints()[joint].parent;
    }
    path.reverse();
    Ok(path)
}

fn dof(motion: &JointMotionSpec, tip: &str, joint: &str) -> Result<usize, DescriptionError> {
    let JointPositionSource::Free { dof } = motion.drive else {
        let reason = format!(
            "the joint `{joint}` on it follows another joint; choose a hand on a chain of joints \
             that move by themselves"
        );
        return Err(chain_error(tip, reason));
    };
    Ok(dof)
}

fn chain_error(tip: &str, reason: String) -> DescriptionError {
    let tip = tip.to_owned();
    DescriptionError::InvalidChain { tip, reason }
}

//! Joint forces that hold a robot still against gravity.

use glam::DVec3;

use crate::description::{
    JointMotionKind, JointMotionSpec, JointPositionSource, Link, RobotDescription,
};
use crate::pose::Pose;

/// Acceleration of the earth's gravity (m/s^2); z is up.
const GRAVITY: DVec3 = DVec3::new(0.0, 0.0, -9.81);

impl RobotDescription {
    /// Returns the joint forces `[num_dofs]` (newtons, newton metres) that hold the robot still
    /// against gravity in `positions`, without a payload.
    ///
    /// The force on a joint that follows another one is added to the followed joint.
    ///
    /// # Panics
    /// If `positions` is not of length [`RobotDescription::num_dofs`].
    pub fn gravity_compensation_forces(&self, positions: &[f64]) -> Vec<f64> {
        let poses = self.link_poses(positions);
        let mut forces = vec![0.0; self.num_dofs];
        let mut loads = self.loads(&poses);
        // from the tips to the root: a joint carries everything that hangs on its link
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let link = index + 1;
            let load = loads[link];
            loads[joint.parent].add(load);
            let Some(motion) = joint.motion else {
                continue;
            };
            let (dof, share) = match motion.drive {
                JointPositionSource::Free { dof } => (dof, 1.0),
                JointPositionSource::Follows { dof, multiplier, .. } => (dof, multiplier),
            };
            forces[dof] -= share * force_on_joint(load, &poses[link], &motion);
        }
        forces
    }

    /// Returns the weight of each link alone, without the links that hang on it.
    fn loads(&self, poses: &[Pose]) -> Vec<Load> {
        let load = |(link, pose): (&Link, &Pose)| {
            link.inertia.map_or(Load::NONE, |inertia| {
                let weight = inertia.mass * GRAVITY;
                let moment = pose.transform_point(inertia.centre_of_mass).cross(weight);
                Load { weight, moment }
            })
        };
        self.links.iter().zip(poses).map(load).collect()
    }
}

/// Returns the force (newtons) or torque (newton metres) of `load` on a joint whose link is at
/// `pose`.
fn force_on_joint(load: Load, pose: &Pose, motion: &JointMotionSpec) -> f64 {
    // the joint's own motion, which `pose` includes, does not change its axis
    let axis = pose.rotation * motion.axis;
    match motion.kind {
        JointMotionKind::Slide => load.weight.dot(axis),
        JointMotionKind::Hinge => (load.moment - pose.position.cross(load.weight)).dot(axis),
    }
}

/// Weight of links (newtons), and its moment about the world's origin (newton metres).
#[derive(Clone, Copy)]
struct Load {
    weight: DVec3,
    moment: DVec3,
}

impl Load {
    const NONE: Self = Self { weight: DVec3::ZERO, moment: DVec3::ZERO };

    /// Adds the load of a link that hangs on these links.
    fn add(&mut self, other: Self) {
        self.weight += other.weight;
        self.moment += other.moment;
    }
}

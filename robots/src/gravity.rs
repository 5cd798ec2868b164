//! What it takes to hold a robot up.

use glam::DVec3;

use crate::description::{Description, Drive, Link, Motion, MotionKind};
use crate::pose::Pose;

/// Of the earth's gravity (m/s^2); z is up.
const GRAVITY: DVec3 = DVec3::new(0.0, 0.0, -9.81);

impl Description {
    /// The forces `[dofs]` (newtons, newton metres) of its joints that hold the robot still against
    /// gravity in `positions`, without any load. A joint that follows another one leaves its part
    /// to that one.
    ///
    /// # Panics
    /// As [`Description::poses`].
    pub fn holding_forces(&self, positions: &[f64]) -> Vec<f64> {
        let poses = self.poses(positions);
        let mut forces = vec![0.0; self.dofs];
        let mut loads = self.loads(&poses);
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let link = index + 1;
            let load = loads[link];
            loads[joint.parent].bear(load);
            let Some(motion) = joint.motion else {
                continue;
            };
            let (dof, share) = match motion.drive {
                Drive::Free { dof } => (dof, 1.0),
                Drive::Follows { dof, multiplier, .. } => (dof, multiplier),
            };
            forces[dof] -= share * pull(load, &poses[link], &motion);
        }
        forces
    }

    /// What each link weighs by itself.
    fn loads(&self, poses: &[Pose]) -> Vec<Load> {
        let load = |(link, pose): (&Link, &Pose)| {
            link.inertia.map_or(Load::NONE, |inertia| {
                let weight = inertia.mass * GRAVITY;
                let moment = pose.point(inertia.centre).cross(weight);
                Load { weight, moment }
            })
        };
        self.links.iter().zip(poses).map(load).collect()
    }
}

/// The force (newtons) or torque (newton metres) of `load` on a joint whose link is at `pose`. A
/// joint's axis is the same before and after its own motion.
fn pull(load: Load, pose: &Pose, motion: &Motion) -> f64 {
    let axis = pose.rotation * motion.axis;
    match motion.kind {
        MotionKind::Slide => load.weight.dot(axis),
        MotionKind::Hinge => (load.moment - pose.position.cross(load.weight)).dot(axis),
    }
}

/// The weight of links (newtons), and its moment about the world's origin (newton metres).
#[derive(Clone, Copy)]
struct Load {
    weight: DVec3,
    moment: DVec3,
}

impl Load {
    const NONE: Self = Self { weight: DVec3::ZERO, moment: DVec3::ZERO };

    /// Adds what hangs on these links.
    fn bear(&mut self, other: Self) {
        self.weight += other.weight;
        self.moment += other.moment;
    }
}

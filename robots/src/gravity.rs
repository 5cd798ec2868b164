//! What it takes to hold a robot up.

use glam::DVec3;

use crate::description::{Description, Drive, MotionKind};

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
        // weight of a link with all that hangs on it, and its moment about the world's origin
        let mut weights: Vec<[DVec3; 2]> = self
            .links
            .iter()
            .zip(&poses)
            .map(|(link, pose)| {
                link.inertia.map_or([DVec3::ZERO; 2], |inertia| {
                    let weight = inertia.mass * GRAVITY;
                    [weight, pose.point(inertia.centre).cross(weight)]
                })
            })
            .collect();
        for (index, joint) in self.joints.iter().enumerate().rev() {
            let link = index + 1;
            let [weight, moment] = weights[link];
            let [below, moment_below] = &mut weights[joint.parent];
            *below += weight;
            *moment_below += moment;
            let Some(motion) = joint.motion else {
                continue;
            };
            // the axis is the same before and after the joint's own motion
            let axis = poses[link].rotation * motion.axis;
            let pull = match motion.kind {
                MotionKind::Slide => weight.dot(axis),
                MotionKind::Hinge => (moment - poses[link].position.cross(weight)).dot(axis),
            };
            match motion.drive {
                Drive::Free { dof } => forces[dof] -= pull,
                Drive::Follows {
                    dof, multiplier, ..
                } => forces[dof] -= multiplier * pull,
            }
        }
        forces
    }
}

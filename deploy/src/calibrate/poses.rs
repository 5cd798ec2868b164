//! Poses to which the hand carries the ball for a camera calibration.

use std::f64::consts::PI;

use envs::embodiments::Arm;
use glam::{DQuat, DVec3};
use robots::Pose;

/// Positions of the hand (metres, world) with its rotation from the working orientation, a rotation
/// vector in the world's axes (degrees). Positions cover the table that policies see, at three
/// heights. Rotations about all axes determine the ball's position in the hand.
const POSES: [([f64; 3], [f64; 3]); 14] = [
    ([0.0, 0.0, 0.22], [0.0, 0.0, 0.0]),
    ([-0.18, -0.12, 0.12], [12.0, 0.0, 20.0]),
    ([0.0, -0.14, 0.12], [0.0, -12.0, 0.0]),
    ([0.18, -0.12, 0.12], [-12.0, 0.0, -20.0]),
    ([0.18, 0.12, 0.12], [0.0, 12.0, 20.0]),
    ([0.0, 0.15, 0.12], [12.0, 0.0, 0.0]),
    ([-0.18, 0.12, 0.12], [0.0, -12.0, -20.0]),
    ([-0.2, 0.0, 0.2], [0.0, 12.0, 0.0]),
    ([-0.1, -0.12, 0.28], [-12.0, 0.0, 20.0]),
    ([0.1, -0.12, 0.28], [0.0, 12.0, -20.0]),
    ([0.2, 0.0, 0.2], [0.0, -12.0, 0.0]),
    ([0.12, 0.1, 0.28], [12.0, 0.0, 20.0]),
    ([0.0, 0.08, 0.3], [0.0, 12.0, 0.0]),
    ([-0.12, 0.1, 0.28], [-12.0, 0.0, -20.0]),
];

/// Returns the 14 poses of the hand of `arm`, in the world, that a camera calibration visits in
/// this order.
pub fn calibration_poses(arm: &Arm) -> Vec<Pose> {
    let working = arm.chain().tip_pose(&arm.settings().ready_joint_positions).rotation;
    let pose = |(place, turn): &([f64; 3], [f64; 3])| {
        let turn = PI / 180.0 * DVec3::from_array(*turn);
        Pose {
            position: DVec3::from_array(*place),
            rotation: (DQuat::from_scaled_axis(turn) * working).normalize(),
        }
    };
    POSES.iter().map(pose).collect()
}

#[cfg(test)]
mod tests {
    use envs::embodiments::KinovaGen3;

    use super::*;

    /// Checks that the inverse kinematics lead from each pose to the next.
    #[test]
    fn a_gen3_reaches_every_pose() {
        let arm = KinovaGen3.arm().unwrap();
        let mut joints = arm.settings().ready_joint_positions.clone();
        for pose in calibration_poses(&arm) {
            joints = arm.chain().solve_ik(&pose, &joints).unwrap();
        }
    }
}

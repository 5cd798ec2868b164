//! Where the hand goes to be looked at.

use std::f64::consts::PI;

use envs::carriers::Arm;
use glam::{DQuat, DVec3};
use robots::Pose;

/// Places of the hand (metres, world), and how it is turned there from how it works: a rotation
/// vector with the axes of the world (degrees). They are spread over the table that policies see
/// and over three heights, and a hand that turns about all axes tells where in it the ball is.
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

/// The poses of `arm`'s hand in which it is looked at, one after the other.
pub fn poses(arm: &Arm) -> Vec<Pose> {
    let working = arm.chain().tip(&arm.settings().ready).rotation;
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
    use envs::carriers::KinovaGen3;

    use super::*;

    /// The arm has a way from each to the next.
    #[test]
    fn a_gen3_reaches_every_pose() {
        let arm = KinovaGen3.arm().unwrap();
        let mut joints = arm.settings().ready.clone();
        for pose in poses(&arm) {
            joints = arm.chain().solve(&pose, &joints).unwrap();
        }
    }
}

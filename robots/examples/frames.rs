//! Prints frames, masses and gravity torques of robots, one line for each URDF: `frames URDF...`.
//! `benches/peers/urdfs.py` compares them with other readers.

use std::env;
use std::path::Path;

use robots::{Joint, JointMotionSpec, JointPositionSource, Pose, RobotDescription};

fn main() {
    for file in env::args().skip(1) {
        match RobotDescription::from_urdf_file(Path::new(&file)) {
            Ok(robot) => println!("{}", facts(&robot)),
            Err(error) => println!("{:?}", error.to_string()),
        }
    }
}

fn facts(robot: &RobotDescription) -> String {
    let postures = [7, 14, 21, 28].map(|seed| {
        let position = |(index, (_, motion)): (usize, (_, &JointMotionSpec))| {
            let part = (0.618_034 * (index + seed) as f64).fract();
            let [low, high] = motion.range.unwrap_or([-3.0, 3.0]).map(|end| end.clamp(-3.0, 3.0));
            low + part * (high - low)
        };
        let positions: Vec<f64> = robot.free_joints().enumerate().map(position).collect();
        let moving = |joint: &Joint| {
            Some((joint.name.clone(), joint.motion?.position_from_dofs(&positions)))
        };
        let joints: Vec<_> = robot.joints().iter().filter_map(moving).collect();
        let frame = |pose: &Pose| (pose.position.to_array(), pose.rotation.to_array());
        let frames: Vec<_> = robot.link_poses(&positions).iter().map(frame).collect();
        (joints, frames, robot.gravity_compensation_forces(&positions))
    });
    // the degree of freedom of a joint that moves, and its share of that one's motion
    let share = |joint: &Joint| match joint.motion?.drive {
        JointPositionSource::Free { dof } => Some((joint.name.clone(), dof, 1.0)),
        JointPositionSource::Follows { dof, multiplier, .. } => {
            Some((joint.name.clone(), dof, multiplier))
        }
    };
    let shares: Vec<_> = robot.joints().iter().filter_map(share).collect();
    let masses = robot.links().iter().filter_map(|link| Some(link.inertia?.mass));
    let links: Vec<&String> = robot.links().iter().map(|link| &link.name).collect();
    format!("{:?}", (links, masses.sum::<f64>(), shares, postures, robot.missing_shape_reasons()))
}

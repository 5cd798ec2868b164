//! Prints frames, masses and gravity torques of robots as JSON, one line for each URDF:
//! `frames URDF...`. `benches/peers/urdfs.py` compares them with other readers.

use std::env;
use std::path::Path;

use robots::{Joint, Pose, PositionSource, RobotDescription};
use serde_json::{Value, json};

fn main() {
    for file in env::args().skip(1) {
        let robot = RobotDescription::from_urdf_file(Path::new(&file));
        let facts = robot.map(|robot| facts(&robot));
        println!("{}", facts.unwrap_or_else(|error| json!({ "error": error.to_string() })));
    }
}

fn facts(robot: &RobotDescription) -> Value {
    let postures = [7, 14, 21, 28].map(|seed| {
        // spread over the ranges
        let joints = robot.free_joints().enumerate().map(|(index, (_, motion))| {
            let part = (0.618_034 * (index + seed) as f64).fract();
            let [low, high] = motion.range.unwrap_or([-3.0, 3.0]).map(|end| end.clamp(-3.0, 3.0));
            low + part * (high - low)
        });
        let positions: Vec<f64> = joints.collect();
        let moving = |joint: &Joint| Some((joint.name.clone(), joint.motion?.position(&positions)));
        let frame =
            |pose: &Pose| [&pose.position.to_array()[..], &pose.rotation.to_array()].concat();
        json!({
            "joints": robot.joints().iter().filter_map(moving).collect::<Vec<_>>(),
            "frames": robot.link_poses(&positions).iter().map(frame).collect::<Vec<_>>(),
            "forces": robot.holding_forces(&positions),
        })
    });
    // the degree of freedom of a joint that moves, and its share of that one's motion
    let share = |joint: &Joint| match joint.motion?.drive {
        PositionSource::Free { dof } => Some(json!([joint.name, dof, 1.0])),
        PositionSource::Follows { dof, multiplier, .. } => {
            Some(json!([joint.name, dof, multiplier]))
        }
    };
    let masses = robot.links().iter().filter_map(|link| Some(link.inertia?.mass));
    json!({
        "links": robot.links().iter().map(|link| &link.name).collect::<Vec<_>>(),
        "mass": masses.sum::<f64>(),
        "shares": robot.joints().iter().filter_map(share).collect::<Vec<_>>(),
        "postures": postures,
        "unread": robot.unread_meshes(),
    })
}

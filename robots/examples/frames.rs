//! Prints frames, masses and gravity torques of robots as JSON, one line for each URDF:
//! `frames URDF...`. `benches/peers/urdfs.py` compares them with other readers.

use std::env;
use std::path::Path;

use robots::{Description, Drive, Joint, Link, Pose};
use serde_json::{Value, json};

/// Number of postures of each robot.
const POSTURES: usize = 4;

fn main() {
    for file in env::args().skip(1) {
        let robot = Description::read(Path::new(&file));
        let facts = robot.map(|robot| facts(&robot));
        println!("{}", facts.unwrap_or_else(|error| json!({ "error": error.to_string() })));
    }
}

fn facts(robot: &Description) -> Value {
    let postures = (1..=POSTURES).map(|number| {
        let positions = positions(robot, number);
        let moving = |joint: &Joint| Some((joint.name.clone(), joint.motion?.position(&positions)));
        let joints: Vec<(String, f64)> = robot.joints().iter().filter_map(moving).collect();
        json!({
            "joints": joints,
            "frames": robot.poses(&positions).iter().map(frame).collect::<Vec<_>>(),
            "forces": robot.holding_forces(&positions),
        })
    });
    // a fixed joint has none
    let share = |joint: &Joint| match joint.motion.map(|motion| motion.drive) {
        Some(Drive::Free { dof }) => json!([joint.name, dof, 1.0]),
        Some(Drive::Follows { dof, multiplier, .. }) => json!([joint.name, dof, multiplier]),
        None => Value::Null,
    };
    let mass = |link: &Link| link.inertia.map_or(0.0, |inertia| inertia.mass);
    json!({
        "links": robot.links().iter().map(|link| &link.name).collect::<Vec<_>>(),
        "masses": robot.links().iter().map(mass).collect::<Vec<_>>(),
        "parents": robot.joints().iter().map(|joint| joint.parent).collect::<Vec<_>>(),
        "shares": robot.joints().iter().map(share).collect::<Vec<_>>(),
        "postures": postures.collect::<Vec<_>>(),
        "notes": robot.notes(),
        "unread": robot.unread_meshes(),
    })
}

/// Positions that are spread over the ranges, different in each posture.
fn positions(robot: &Description, number: usize) -> Vec<f64> {
    let joints = robot.free_joints().enumerate();
    let position = |(index, (_, motion)): (usize, (_, &robots::Motion))| {
        let part = (0.618_034 * (index + 7 * number) as f64).fract();
        let [low, high] = motion.range.unwrap_or([-3.0, 3.0]).map(|end| end.clamp(-3.0, 3.0));
        low + part * (high - low)
    };
    joints.map(position).collect()
}

/// Position and rotation (x, y, z, w).
fn frame(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [a, b, c, d]) = (pose.position.to_array(), pose.rotation.to_array());
    [x, y, z, a, b, c, d]
}

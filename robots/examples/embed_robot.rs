//! Reads a URDF, prints its joints and capsules, and moves its tip to and fro in a dry run.
//!
//! `embed_robot [URDF TIP_LINK]`; without arguments, the Kinova Gen3. With the environment variable
//! `MJCF=1` it prints the robot's MJCF and nothing else.

use std::cell::Cell;
use std::env;
use std::error::Error;
use std::path::Path;
use std::time::Duration;

use glam::DVec3;
use robots::{
    ArmCommand, Chain, ControlError, JointServoSettings, KinematicArm, MjcfSettings, Robot,
    RobotDescription, Twist, TwistControlSettings, TwistController, Watchdog, gen3,
};

/// Time between two commands.
const PERIOD: Duration = Duration::from_millis(25);

/// Joints of the Gen3 on the way to its tool.
const GEN3_JOINTS: [&str; 7] =
    ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (arm, tip) = match &arguments[..] {
        [] => (gen3::gen3_description()?, "tool_link"),
        [file, tip] => (RobotDescription::from_urdf_file(Path::new(file))?, &tip[..]),
        _ => return Err("usage: embed_robot [URDF TIP_LINK]".into()),
    };
    arm.import_notes()
        .iter()
        .chain(arm.missing_shape_reasons())
        .for_each(|note| eprintln!("{note}"));
    if env::var_os("MJCF").is_some() {
        let mjcf = arm.to_mjcf(&MjcfSettings {
            servo: Some(JointServoSettings::default()),
            ..MjcfSettings::default()
        })?;
        print!("{}", mjcf.text);
        for [first, second] in mjcf.excluded_pairs.iter() {
            eprintln!(
                "{first} and {second} touch at rest or in most postures, so they do not collide"
            );
        }
        return Ok(());
    }
    let chain = Chain::new(&arm, tip)?;
    let posture = posture(&arm, &chain);
    describe(&arm, &chain, &posture);
    let control = TwistController::new(chain, &posture, TwistControlSettings::default())?;
    Ok(dry_run(KinematicArm::new(control))?)
}

/// The Gen3's posture for work on a table; of another arm, a bent one: two thirds of all
/// ranges.
fn posture(arm: &RobotDescription, chain: &Chain) -> Vec<f64> {
    let names = chain.joints().iter().map(|joint| &joint.name[..]);
    // another robot may have the Gen3's name
    if arm.name() == "kinova_gen3" && names.eq(GEN3_JOINTS) {
        return gen3::WORK_JOINT_POSITIONS.to_vec();
    }
    let ranges = chain.joints().iter().map(|joint| joint.motion.range);
    ranges.map(|range| range.map_or(0.5, |[low, high]| (low + 2.0 * high) / 3.0)).collect()
}

fn describe(arm: &RobotDescription, chain: &Chain, posture: &[f64]) {
    for of in arm.range_restrictions() {
        let (joint, follower) = (&of.joint, &of.follower);
        println!(
            "the range of {joint} is smaller than in the file, so that {follower} keeps to its own"
        );
    }
    for (joint, position) in chain.joints().iter().zip(posture) {
        let (name, range) = (&joint.name, joint.motion.range);
        println!("joint {name} at {position:.3}, range {range:?}");
    }
    let mut positions = vec![0.0; arm.num_dofs()];
    for (joint, &position) in chain.joints().iter().zip(posture) {
        positions[joint.dof_index] = position;
    }
    for (link, capsule) in arm.enclosing_capsules(&positions) {
        let (name, [start, end]) = (&arm.links()[link].name, capsule.ends);
        println!("{name}: {start:.3} to {end:.3}, radius {:.3} m", capsule.radius);
    }
}

/// Half a second along each axis and back, then half a second without commands.
fn dry_run(arm: KinematicArm) -> Result<(), ControlError> {
    let now = Cell::new(Duration::ZERO);
    let mut robot = Watchdog::new(arm, || now.get());
    let ways = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]).map(Some);
    for way in ways.chain([None]) {
        for _ in 0..20 {
            if let Some(way) = way {
                let twist = Twist::from_linear(0.1 * way);
                robot.command(&ArmCommand { twist, gripper_closure: 0.0 })?;
            }
            robot.robot_mut().advance(PERIOD.as_secs_f64())?;
            now.set(now.get() + PERIOD);
        }
        let place = robot.state()?.tip.position;
        println!("{:4} ms: tip at {place:.3}", now.get().as_millis());
    }
    Ok(())
}

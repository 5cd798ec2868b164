//! The Gen3's URDF against the figures that it was written from, and against MuJoCo's kinematics.

use std::sync::Arc;

use glam::{DMat4, DVec3};
use mujoco::{Data, Model};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::{Chain, MjcfSettings, Pose, RobotDescription, gen3};

/// Capsules fitted to the published meshes: link, ends in its frame, radius (metres).
const CAPSULES: &str = "\
base_link                  0.0    0.0  0.016     0.0    0.0  0.144  0.053
shoulder_link              0.0    0.0 -0.032     0.0 -0.008 -0.129  0.053
half_arm_1_link            0.0  0.003 -0.021     0.0 -0.212 -0.006  0.048
half_arm_2_link            0.0    0.0 -0.030     0.0 -0.004 -0.216  0.052
forearm_link               0.0  0.003 -0.020     0.0 -0.188 -0.006  0.048
spherical_wrist_1_link     0.0    0.0 -0.030     0.0 -0.013 -0.106  0.043
spherical_wrist_2_link     0.0 -0.001 -0.020     0.0 -0.100    0.0  0.039
bracelet_link              0.0 -0.050 -0.054     0.0 -0.002 -0.036  0.048
gripper_link               0.0    0.0    0.0     0.0    0.0  0.070  0.043
";

/// The user guide's table of Denavit and Hartenberg (classical, all a are 0): alpha (quarter
/// turns), d (metres), theta at zero (quarter turns). It rounds lengths to 0.1 mm and leaves out
/// 0.175 mm at two joints of the wrist, 0.62 mm in all.
const DENAVIT_HARTENBERG: [(f64, f64, f64); 8] = [
    (2.0, 0.0, 0.0),
    (1.0, -(0.1564 + 0.1284), 0.0),
    (1.0, -(0.0054 + 0.0064), 2.0),
    (1.0, -(0.2104 + 0.2104), 2.0),
    (1.0, -(0.0064 + 0.0064), 2.0),
    (1.0, -(0.2084 + 0.1059), 2.0),
    (1.0, 0.0, 2.0),
    (2.0, -(0.1059 + 0.0615), 2.0),
];

fn arm() -> RobotDescription {
    gen3::gen3_description().unwrap()
}

fn random(generator: &mut ChaCha8Rng, num_dofs: usize) -> Vec<f64> {
    (0..num_dofs).map(|_| generator.random_range(-3.2..3.2)).collect()
}

/// Returns the pose of the flange by the table.
fn by_table(joints: &[f64]) -> DMat4 {
    let quarter = std::f64::consts::FRAC_PI_2;
    let positions = [&[0.0], joints].concat();
    let rows = DENAVIT_HARTENBERG.iter().zip(positions);
    rows.fold(DMat4::IDENTITY, |pose, (&(alpha, d, theta), position)| {
        let turn = DMat4::from_rotation_z(position + theta * quarter);
        let along = DMat4::from_translation(d * DVec3::Z);
        pose * turn * along * DMat4::from_rotation_x(alpha * quarter)
    })
}

#[test]
fn the_flange_is_where_the_user_guide_has_it() {
    let chain = Chain::new(&arm(), "end_effector_link").unwrap();
    let mut generator = ChaCha8Rng::seed_from_u64(1000);
    for _ in 0..1000 {
        let joints = random(&mut generator, 7);
        let tip = chain.tip_pose(&joints);
        let expected = by_table(&joints);
        let distance = tip.position.distance(expected.w_axis.truncate());
        assert!(distance < 6.2e-4, "{distance} at {joints:?}");
        for (axis, column) in [(DVec3::X, expected.x_axis), (DVec3::Y, expected.y_axis)] {
            assert!((tip.rotation * axis).distance(column.truncate()) < 1e-12);
        }
    }
}

/// Compares MuJoCo's frames of all bodies of `model` with those of the arm's links.
fn check_against(model: Model, arm: &RobotDescription) {
    let model = Arc::new(model);
    let mut data = Data::new(Arc::clone(&model));
    let bodies: Vec<_> = arm.links().iter().map(|link| model.body(&link.name).unwrap()).collect();
    let mut generator = ChaCha8Rng::seed_from_u64(1001);
    for _ in 0..1000 {
        let positions = random(&mut generator, arm.num_dofs());
        for joint in arm.joints() {
            if let Some(motion) = &joint.motion {
                let address = model.joint_qpos_address(model.joint(&joint.name).unwrap());
                data.qpos_mut()[address] = motion.position_from_dofs(&positions);
            }
        }
        data.forward_kinematics().unwrap();
        for (pose, &body) in arm.link_poses(&positions).iter().zip(&bodies) {
            let expected = DVec3::from_array(data.body_position(body));
            assert!(pose.position.distance(expected) < 1e-9, "{pose:?} {expected}");
            let [w, x, y, z] = data.body_orientation(body);
            let same = pose.rotation.dot(glam::DQuat::from_xyzw(x, y, z, w)).abs();
            assert!(same > 1.0 - 1e-12, "{same}");
        }
    }
}

#[test]
fn links_are_where_mujoco_has_them_after_reading_the_urdf() {
    let files = [("gen3.urdf", gen3::GEN3_URDF.as_bytes())];
    check_against(Model::from_files("gen3.urdf", &files).unwrap(), &arm());
}

#[test]
fn links_are_where_mujoco_has_them_after_reading_our_mjcf() {
    let base = Pose::from_xyz_rpy([0.1, -0.6, 0.02], [0.1, -0.2, 1.5]);
    let arm = arm().with_base_pose(base).unwrap();
    let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap();
    check_against(Model::from_xml(&mjcf.text).unwrap(), &arm);
}

#[test]
fn named_poses_are_where_the_sheet_has_them() {
    let arm = arm();
    let [flange, tool] =
        ["end_effector_link", "tool_link"].map(|tip| Chain::new(&arm, tip).unwrap());
    for (chain, joints, expected, down) in [
        (&flange, gen3::HOME_JOINT_POSITIONS, [0.457, 0.001, 0.434], 0.0),
        (&tool, gen3::RETRACT_JOINT_POSITIONS, [0.130, 0.001, 0.209], 1.0),
        (&flange, gen3::ZERO_JOINT_POSITIONS, [0.0, -0.0249, 1.187], -1.0),
        (&tool, gen3::WORK_JOINT_POSITIONS, [0.45, 0.0, 0.15], 1.0),
    ] {
        let tip = chain.tip_pose(&joints);
        let distance = tip.position.distance(DVec3::from_array(expected));
        assert!(distance < 2e-3, "{} {expected:?}", tip.position);
        let axis = tip.rotation * DVec3::Z;
        // the sheet: "within 4 degrees of straight down"
        assert!((-axis.z - down).abs() < 3e-3, "{axis}");
    }
    let home = flange.tip_pose(&gen3::HOME_JOINT_POSITIONS).rotation * DVec3::Z;
    assert!(home.x > 0.999, "{home}");
}

#[test]
fn capsules_are_those_of_the_sheet_and_follow_their_links() {
    let arm = arm();
    let positions = [&gen3::WORK_JOINT_POSITIONS[..], &[0.01]].concat();
    let (poses, capsules) = (arm.link_poses(&positions), arm.enclosing_capsules(&positions));
    for line in CAPSULES.lines() {
        let (name, numbers) = line.split_once(' ').unwrap();
        let numbers = numbers.split_whitespace();
        let numbers: Vec<f64> = numbers.map(|number| number.parse().unwrap()).collect();
        let link = arm.links().iter().position(|link| link.name == name).unwrap();
        let of_link: Vec<_> = capsules.iter().filter(|(index, _)| *index == link).collect();
        let [(_, capsule)] = of_link[..] else {
            panic!("{name} has {} capsules", of_link.len());
        };
        for (end, expected) in capsule.ends.iter().zip(numbers.chunks_exact(3)) {
            let expected = poses[link].transform_point(DVec3::from_slice(expected));
            assert!(end.distance(expected) < 1e-6, "{name}: {end} {expected}");
        }
        assert_eq!(capsule.radius, numbers[6]);
    }
    // two fingers, each a capsule and a pad
    assert_eq!(capsules.len(), CAPSULES.lines().count() + 4);
}

#[test]
fn masses_and_fingers_are_those_of_the_sheet() {
    let arm = arm();
    let masses = arm.links().iter().filter_map(|link| link.inertia.map(|inertia| inertia.mass));
    let total: f64 = masses.sum();
    assert!((total - 8.188 - 0.9226).abs() < 1e-3, "{total}");
    assert_eq!(arm.num_dofs(), 8);
    for (closing, gap) in [(0.0, 0.085), (0.0425, 0.0)] {
        let poses = arm.link_poses(&[&gen3::ZERO_JOINT_POSITIONS[..], &[closing]].concat());
        let finger = |name: &str| {
            let link = arm.links().iter().position(|link| link.name == name).unwrap();
            poses[link].position
        };
        let distance = finger("finger_l_link").distance(finger("finger_r_link"));
        assert!((distance - gap).abs() < 1e-12, "{distance}");
    }
}

#[test]
fn fingers_may_be_kept_half_open() {
    let range = |arm: &RobotDescription| {
        let mut joints = arm.free_joints();
        joints.find(|(joint, _)| joint.name == "finger_l").unwrap().1.range
    };
    assert_eq!(range(&arm()), Some([0.0, 0.0425]));
    let half = arm().with_joint_range("finger_l", [0.02, 0.0425]).unwrap();
    assert_eq!(range(&half), Some([0.02, 0.0425]));
    for (joint, low, high, says) in [
        ("finger_l", -0.001, 0.04, "lower end of its new range is -0.001"),
        ("finger_l", f64::NAN, 0.04, "lower end of its new range is NaN"),
        ("finger_l", 0.02, 0.043, "upper end of its new range is 0.043"),
        ("finger_l", 0.02, 0.02, "upper end of its new range is 0.02"),
        ("finger_l", 0.0, f64::NAN, "upper end of its new range is NaN"),
        ("finger_r", 0.02, 0.04, "follows no other"),
        ("joint_1", 0.0, 1.0, "has a range"),
        ("thumb", 0.02, 0.04, "has a range"),
    ] {
        let refused = arm().with_joint_range(joint, [low, high]).unwrap_err().to_string();
        for part in [says, joint] {
            assert!(refused.contains(part), "{part}: {refused}");
        }
    }
}

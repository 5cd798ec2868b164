//! Inverse kinematics over whole workspaces: arms of five, six and seven joints, from one seed.

use std::f64::consts::PI;
use std::fmt::Write;
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use robots::{
    Chain, ControlError, IkSettings, OrientationConstraint, Pose, RobotDescription, Twist,
    TwistControlSettings, TwistController, gen3,
};

use crate::control::random;

/// Joints of an arm: axis, offset from the joint before it (metres) and range (radians).
type Joints = &'static [(&'static str, &'static str, [f64; 2])];

const FIVE: Joints = &[
    ("0 0 1", "0 0 0.05", [-1.9, 1.9]),
    ("0 1 0", "0.03 0 0.05", [-1.7, 1.7]),
    ("0 1 0", "0 0 0.12", [-1.7, 1.7]),
    ("0 1 0", "0.13 0 0", [-1.6, 1.6]),
    ("1 0 0", "0.06 0 0", [-2.7, 2.7]),
];
/// Three parallel axes and offsets in the wrist; each joint turns twice.
const SIX: Joints = &[
    ("0 0 1", "0 0 0.15", [-2.0 * PI, 2.0 * PI]),
    ("0 1 0", "0 0.12 0", [-2.0 * PI, 2.0 * PI]),
    ("0 1 0", "0 -0.09 0.24", [-PI, PI]),
    ("0 1 0", "0 0 0.21", [-2.0 * PI, 2.0 * PI]),
    ("0 0 1", "0 0.09 0", [-2.0 * PI, 2.0 * PI]),
    ("0 1 0", "0 0 0.08", [-2.0 * PI, 2.0 * PI]),
];
/// Shoulder, elbow and wrist without offsets.
const SEVEN: Joints = &[
    ("0 0 1", "0 0 0.16", [-2.9, 2.9]),
    ("0 1 0", "0 0 0.18", [-2.0, 2.0]),
    ("0 0 1", "0 0 0.2", [-2.9, 2.9]),
    ("0 -1 0", "0 0 0.2", [-2.0, 2.0]),
    ("0 0 1", "0 0 0.2", [-2.9, 2.9]),
    ("0 1 0", "0 0 0.2", [-2.0, 2.0]),
    ("0 0 1", "0 0 0.1", [-3.0, 3.0]),
];

fn arm(joints: Joints) -> Chain {
    let mut urdf = "<robot name=\"arm\"><link name=\"l0\"/>".to_owned();
    for (index, (axis, offset, [low, high])) in joints.iter().enumerate() {
        let next = index + 1;
        write!(
            urdf,
            r#"<link name="l{next}"><inertial><mass value="1"/>
              <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="j{next}" type="revolute"><parent link="l{index}"/><child link="l{next}"/>
              <origin xyz="{offset}"/><axis xyz="{axis}"/>
              <limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>"#
        )
        .unwrap();
    }
    let last = joints.len();
    write!(
        urdf,
        r#"<link name="tip"/><joint name="tool" type="fixed"><parent link="l{last}"/>
        <child link="tip"/><origin xyz="0.02 0 0.06" rpy="0.1 0.2 0"/></joint></robot>"#
    )
    .unwrap();
    Chain::new(&RobotDescription::from_urdf(&urdf).unwrap(), "tip").unwrap()
}

fn kinova() -> Chain {
    Chain::new(&gen3::gen3_description().unwrap(), "tool_link").unwrap()
}

fn middle(chain: &Chain) -> Vec<f64> {
    let joints = chain.joints().iter();
    joints.map(|of| of.motion.range.map_or(0.0, |[low, high]| 0.5 * (low + high))).collect()
}

/// Settings whose results do not depend on the clock.
fn settings(orientation: OrientationConstraint) -> IkSettings {
    let time_limit = Duration::from_secs(3600);
    IkSettings { orientation, time_limit, ..IkSettings::default() }
}

/// Checks that `joints` bring the tip to `target` and keep to the ranges.
#[track_caller]
fn check(chain: &Chain, orientation: OrientationConstraint, target: &Pose, joints: &[f64]) {
    let tip = chain.tip_pose(joints);
    assert!(tip.position.distance(target.position) < 1e-9);
    let [_, turn] = tip.displacement_to(target);
    let off = match orientation {
        OrientationConstraint::Full => turn.length(),
        OrientationConstraint::Axis(axis) => {
            (tip.rotation * axis.normalize()).distance(target.rotation * axis.normalize())
        }
        OrientationConstraint::Free => 0.0,
    };
    assert!(off < 1e-7, "{off}");
    for (joint, position) in chain.joints().iter().zip(joints) {
        let [low, high] = joint.motion.range.unwrap_or([f64::MIN, f64::MAX]);
        assert!((low..=high).contains(position), "{}: {position}", joint.name);
    }
}

/// Prints the times too, which are no part of the test.
#[test]
fn reachable_targets_are_found_from_the_middle_of_the_ranges() {
    const TARGETS: usize = 100;
    let (full, axis) =
        (OrientationConstraint::Full, OrientationConstraint::Axis(DVec3::new(0.0, 0.5, 2.0)));
    for (name, chain, orientation) in [
        ("Gen3", kinova(), full),
        ("five joints", arm(FIVE), full),
        ("five joints, free axis", arm(FIVE), axis),
        ("five joints, position", arm(FIVE), OrientationConstraint::Free),
        ("six joints", arm(SIX), full),
        ("seven joints", arm(SEVEN), full),
    ] {
        let mut generator = ChaCha8Rng::seed_from_u64(1005);
        let (seed, settings) = (middle(&chain), settings(orientation));
        let (mut found, mut times) = (0, Vec::new());
        for _ in 0..TARGETS {
            let target = chain.tip_pose(&random(&chain, &mut generator));
            let started = Instant::now();
            let solved = chain.solve_ik_with_settings(&target, &seed, &settings);
            times.push(started.elapsed());
            match solved {
                Ok(joints) => {
                    check(&chain, orientation, &target, &joints);
                    found += 1;
                }
                Err(error) => assert!(matches!(error, ControlError::NoSolution { .. }), "{error}"),
            }
        }
        times.sort_unstable();
        let [median, slowest] = [times[TARGETS / 2], times[TARGETS - 1]];
        println!("{name}: {found} of {TARGETS}, median {median:.1?}, slowest {slowest:.1?}");
        assert!(100 * found >= 97 * TARGETS, "{name}: {found}");
    }
}

/// A target beyond the links is out of reach, and nothing is said of one that was only not found.
#[test]
fn targets_without_a_solution_are_told_from_those_out_of_reach() {
    for chain in [kinova(), arm(FIVE), arm(SIX), arm(SEVEN)] {
        let seed = middle(&chain);
        let target = Pose { position: DVec3::new(1.5, 0.2, 0.3), ..chain.tip_pose(&seed) };
        for orientation in [
            OrientationConstraint::Full,
            OrientationConstraint::Free,
            OrientationConstraint::Axis(DVec3::X),
        ] {
            let error =
                chain.solve_ik_with_settings(&target, &seed, &settings(orientation)).unwrap_err();
            let ControlError::OutOfReach { distance, reach, .. } = &error else {
                panic!("{error}");
            };
            assert!(distance > reach && *reach < 1.3, "{error}");
            assert!(error.to_string().contains(&format!("{reach:.4} m")), "{error}");
        }
    }
    // the last axis of five is always in the plane of the upper arm
    let (chain, seed) = (arm(FIVE), [0.0, 0.3, 0.3, 0.3, 0.0]);
    let tip = chain.tip_pose(&seed);
    let across = Pose { rotation: DQuat::from_rotation_z(1.5) * tip.rotation, ..tip };
    let error = chain
        .solve_ik_with_settings(&across, &seed, &settings(OrientationConstraint::Full))
        .unwrap_err();
    let ControlError::NoSolution { miss, searches: 50 } = &error else {
        panic!("{error}");
    };
    assert!(miss.distance.max(miss.angle) > 1e-3, "{error}");
    let stretched = Pose { rotation: tip.rotation * 2.0, ..tip };
    let refused = chain
        .solve_ik_with_settings(&stretched, &seed, &settings(OrientationConstraint::Full))
        .unwrap_err();
    assert!(refused.to_string().contains("rotation is"), "{refused}");
}

#[test]
fn searches_are_the_same_in_every_call_and_end_with_the_settings() {
    let (chain, target) = (arm(SIX), Pose { position: DVec3::ZERO, ..Pose::IDENTITY });
    let seed = middle(&chain);
    let solve =
        |settings: IkSettings| chain.solve_ik_with_settings(&target, &seed, &settings).unwrap_err();
    let none = solve(IkSettings { max_searches: 0, ..IkSettings::default() });
    assert!(none.to_string().contains("at least 1 search"), "{none}");
    for (time_limit, max_searches, made) in [(0, 50, 1), (3600, 1, 1), (3600, 7, 7)] {
        let time_limit = Duration::from_secs(time_limit);
        let error = solve(IkSettings { max_searches, time_limit, ..IkSettings::default() });
        assert!(error.to_string().contains(&format!("best of {made} searches")), "{error}");
    }
    let hard = chain.tip_pose(&[2.0, 3.0, -2.5, 1.0, -4.0, 5.0]);
    let settings = settings(OrientationConstraint::Full);
    let [one, other] =
        [(); 2].map(|()| chain.solve_ik_with_settings(&hard, &seed, &settings).unwrap());
    assert_eq!(one, other);
    for axis in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY] {
        let error =
            solve(IkSettings { orientation: OrientationConstraint::Axis(axis), ..settings });
        assert!(matches!(error, ControlError::InvalidSetting { .. }), "{error}");
    }
}

/// Five joints turn the tip about the vertical when it moves sideways.
#[test]
fn five_joints_follow_twists_with_a_free_axis() {
    let posture = [0.0, 0.2, 0.6, -0.3, 0.1];
    let in_tip = |axis: DVec3| arm(FIVE).tip_pose(&posture).rotation.conjugate() * axis;
    for (orientation, follows) in [
        (OrientationConstraint::Full, false),
        (OrientationConstraint::Axis(in_tip(DVec3::Y)), false),
        (OrientationConstraint::Axis(in_tip(DVec3::Z)), true),
        (OrientationConstraint::Free, true),
    ] {
        let settings = TwistControlSettings { orientation, ..TwistControlSettings::default() };
        let mut control = TwistController::new(arm(FIVE), &posture, settings).unwrap();
        let start = control.tip_pose();
        let twist = Twist { linear: 0.05 * DVec3::Y, angular: DVec3::ZERO };
        let followed = (0..80).try_for_each(|_| {
            control.command_twist(twist)?;
            control.tick(0.025)
        });
        println!("{orientation:?}: {followed:?}");
        assert_eq!(followed.is_ok(), follows, "{orientation:?}");
        if follows {
            let way = control.tip_pose().position - start.position;
            assert!(way.y > 0.08 && way.x.abs().max(way.z.abs()) < 5e-3, "{way}");
        }
    }
}

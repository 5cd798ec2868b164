//! Kinematics and control: the Jacobian, inverse kinematics, and Cartesian control.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::{
    Chain, ControlError, Pose, RobotDescription, Twist, TwistControlSettings, TwistController, gen3,
};

use crate::SIX_JOINT;

/// Length of a tick (seconds).
const TICK: f64 = 0.0125;

fn chain(tip: &str) -> Chain {
    Chain::new(&gen3::gen3_description().unwrap(), tip).unwrap()
}

fn at_work() -> TwistController {
    TwistController::new(
        chain("tool_link"),
        &gen3::WORK_JOINT_POSITIONS,
        TwistControlSettings::default(),
    )
    .unwrap()
}

pub fn random(chain: &Chain, generator: &mut ChaCha8Rng) -> Vec<f64> {
    let within = chain.joints().iter().map(|joint| {
        let [low, high] = joint.motion.range.unwrap_or([-3.0, 3.0]);
        generator.random_range(low..high)
    });
    within.collect()
}

#[test]
fn the_jacobian_is_the_derivative_of_the_tip() {
    let six = RobotDescription::from_urdf(SIX_JOINT).unwrap();
    let placed =
        six.with_base_pose(Pose::from_xyz_rpy([0.3, 0.1, -0.2], [0.5, 0.4, -1.0])).unwrap();
    for chain in [chain("tool_link"), Chain::new(&placed, "tip").unwrap()] {
        let mut generator = ChaCha8Rng::seed_from_u64(1003);
        let mut columns = vec![Twist::ZERO; chain.joints().len()];
        for _ in 0..50 {
            let joints = random(&chain, &mut generator);
            assert_eq!(chain.jacobian(&joints, &mut columns), chain.tip_pose(&joints));
            for (joint, column) in columns.iter().enumerate() {
                let moved = |by: f64| {
                    let mut joints = joints.clone();
                    joints[joint] += by;
                    chain.tip_pose(&joints)
                };
                let [linear, angular] =
                    moved(-1e-6).displacement_to(&moved(1e-6)).map(|way| way / 2e-6);
                assert!(linear.distance(column.linear) < 1e-8, "{linear} {column:?}");
                assert!(angular.distance(column.angular) < 1e-8, "{angular} {column:?}");
            }
        }
    }
}

#[test]
fn chains_that_cannot_be_moved_are_refused() {
    let arm = gen3::gen3_description().unwrap();
    let refused = |tip: &str| Chain::new(&arm, tip).unwrap_err().to_string();
    assert!(refused("base_link").contains("no joint on it moves"));
    assert!(refused("finger_r_link").contains("`finger_r` on it follows"));
    let unknown = refused("hand");
    assert!(unknown.contains("`hand`") && unknown.contains("tool_link"), "{unknown}");
}

/// Postures with the tool straight down: radius and height of the tool frame (metres), then joints
/// 2, 4 and 6 (radians).
const TOOL_DOWN: [[f64; 5]; 9] = [
    [0.25, 0.10, 0.338, -2.445, -0.359],
    [0.30, 0.05, 0.557, -2.335, -0.250],
    [0.30, 0.25, 0.080, -2.050, -1.012],
    [0.45, 0.05, 0.722, -1.841, -0.579],
    [0.45, 0.15, 0.537, -1.761, -0.844],
    [0.45, 0.25, 0.405, -1.607, -1.130],
    [0.60, 0.05, 0.968, -1.236, -0.938],
    [0.60, 0.25, 0.760, -0.977, -1.404],
    [0.68, 0.05, 1.166, -0.773, -1.203],
];

fn tool_down(x: f64, y: f64, z: f64) -> Pose {
    Pose {
        position: DVec3::new(x, y, z),
        rotation: chain("tool_link").tip_pose(&gen3::WORK_JOINT_POSITIONS).rotation,
    }
}

#[test]
fn the_inverse_finds_the_postures_of_the_sheet() {
    let chain = chain("tool_link");
    for [radius, height, second, fourth, sixth] in TOOL_DOWN {
        let target = tool_down(radius, 0.0, height);
        let joints = chain.solve_ik(&target, &gen3::WORK_JOINT_POSITIONS).unwrap();
        let tip = chain.tip_pose(&joints);
        assert!(tip.position.distance(target.position) < 1e-9);
        for (joint, expected) in [(1, second), (3, fourth), (5, sixth)] {
            // the redundant arm has many solutions, of which the table lists one
            let off = (joints[joint] - expected).abs();
            assert!(
                off < 0.02,
                "joint {joint} at {radius}, {height}: {} {expected}",
                joints[joint]
            );
        }
    }
}

#[test]
fn a_twist_that_is_reversed_while_the_arm_accelerates_is_followed() {
    let mut control = at_work();
    control.command_twist(Twist::from_linear(-0.1 * DVec3::Y)).unwrap();
    control.tick(0.025).unwrap();
    let turned_at = control.tip_pose().position.y;
    // the speed passes zero exactly after one more tick
    control.command_twist(Twist::from_linear(0.1 * DVec3::Y)).unwrap();
    (0..20).for_each(|_| control.tick(0.025).unwrap());
    let way = control.tip_pose().position.y - turned_at;
    assert!(way > 0.02, "the arm stopped after {way} m");
}

#[test]
fn places_out_of_reach_and_targets_that_are_none_are_refused() {
    let chain = chain("tool_link");
    let far = chain.solve_ik(&tool_down(0.9, 0.0, 0.1), &gen3::WORK_JOINT_POSITIONS).unwrap_err();
    let ControlError::OutOfReach { target, distance, reach, .. } = &far else {
        panic!("{far}");
    };
    assert!(target.x == 0.9 && *reach < 0.85 && *distance > 0.89, "{far}");
    let nowhere = Pose { position: DVec3::NAN, rotation: DQuat::IDENTITY };
    let error = chain.solve_ik(&nowhere, &gen3::WORK_JOINT_POSITIONS).unwrap_err();
    assert!(matches!(error, ControlError::NotFinite { .. }), "{error}");
    let mut bent = gen3::WORK_JOINT_POSITIONS;
    bent[3] = -2.6;
    let bent_error = chain.solve_ik(&tool_down(0.45, 0.0, 0.1), &bent).unwrap_err();
    assert!(bent_error.to_string().contains("`joint_4` is at -2.6"), "{bent_error}");
}

#[test]
fn a_twist_moves_the_tip_and_keeps_its_orientation() {
    let mut control = at_work();
    let start = control.tip_pose();
    let limits = TwistControlSettings::default().limits;
    for (way, seconds) in [(DVec3::Y, 1.0), (-DVec3::Y, 2.0), (DVec3::new(0.6, 0.0, -0.8), 1.0)] {
        let before = control.tip_pose();
        control.command_twist(Twist::from_linear(0.1 * way)).unwrap();
        let mut travelled = DVec3::ZERO;
        for _ in 0..(seconds / TICK) as usize {
            control.tick(TICK).unwrap();
            travelled += TICK * control.current_twist().linear;
        }
        let tip = control.tip_pose();
        assert!((tip.position - before.position).distance(travelled) < 2e-3);
        // to turn round takes 0.2 m/s, half of which is lost on the way
        let least = 0.1 * seconds - 0.1 * 0.2 / limits.max_acceleration - 0.01;
        assert!(least > 0.0 && travelled.dot(way) > least, "{travelled}");
        let [_, turn] = start.displacement_to(&tip);
        assert!(turn.length() < 5e-3, "{turn}");
    }
}

/// The tip stops at its target, without passing it by more than two millimetres.
#[test]
fn a_twist_towards_a_target_ends_there() {
    let mut control = at_work();
    let limits = TwistControlSettings::default().limits;
    let start = control.tip_pose();
    let turned = DQuat::from_rotation_z(0.3) * start.rotation;
    let target = Pose { position: start.position + DVec3::new(0.05, 0.1, 0.02), rotation: turned };
    let mut fastest = 0.0_f64;
    for _ in 0..200 {
        let way = control.tip_pose().displacement_to(&target);
        control.command_twist(limits.twist_towards(way, 10.0)).unwrap();
        control.tick(TICK).unwrap();
        fastest = fastest.max(control.current_twist().linear.length());
        let passed =
            (control.tip_pose().position - target.position).dot(DVec3::new(0.05, 0.1, 0.02));
        assert!(passed < 2e-3 * 0.113, "{passed}");
    }
    let [way, turn] = control.tip_pose().displacement_to(&target);
    assert!(way.length() < 1e-4 && turn.length() < 1e-3, "{way} {turn}");
    assert!(fastest > 0.15 && fastest <= limits.max_speed, "{fastest}");
}

#[test]
fn an_arm_at_rest_moves_no_joint() {
    let mut control = at_work();
    let mut elsewhere = gen3::WORK_JOINT_POSITIONS;
    elsewhere[2] += 0.5;
    control.restart(&elsewhere).unwrap();
    for _ in 0..100 {
        control.tick(TICK).unwrap();
    }
    assert_eq!(control.joint_positions(), elsewhere);
    // but as soon as the tip moves, the elbow goes back towards its posture
    for round in 0..20 {
        let way = if round % 2 == 0 { 0.1 } else { -0.1 };
        control.command_twist(Twist::from_linear(way * DVec3::Z)).unwrap();
        for _ in 0..40 {
            control.tick(TICK).unwrap();
        }
    }
    let left = (control.joint_positions()[2] - gen3::WORK_JOINT_POSITIONS[2]).abs();
    assert!(left < 0.35, "{left}");
}

/// Real arms report the positions of continuous joints modulo one turn.
#[test]
fn whole_turns_of_an_endless_joint_change_nothing() {
    let velocities = |turn: f64| {
        let mut joints = gen3::WORK_JOINT_POSITIONS;
        for (joint, position) in chain("tool_link").joints().iter().zip(&mut joints) {
            *position += if joint.motion.range.is_none() { turn } else { 0.0 };
        }
        let mut control = at_work();
        control.restart(&joints).unwrap();
        control.command_twist(Twist::from_linear(0.1 * DVec3::Y)).unwrap();
        control.tick(TICK).unwrap();
        control.joint_velocities().to_vec()
    };
    let straight = velocities(0.0);
    for turns in [-2.0, -1.0, 1.0] {
        let turned = velocities(turns * 2.0 * PI);
        for (expected, got) in straight.iter().zip(&turned) {
            assert!((expected - got).abs() < 1e-9, "{expected} {got}");
        }
    }
}

#[test]
fn commands_that_are_not_finite_stop_the_arm() {
    let mut control = at_work();
    for bad in [
        Twist::from_linear(DVec3::NAN),
        // its speed is not finite
        Twist::from_linear(1e200 * DVec3::X),
        Twist { angular: DVec3::INFINITY, ..Twist::ZERO },
    ] {
        control.command_twist(Twist::from_linear(0.1 * DVec3::Y)).unwrap();
        control.tick(TICK).unwrap();
        assert!(control.joint_velocities().iter().any(|&velocity| velocity != 0.0));
        let error = control.command_twist(bad).unwrap_err();
        assert!(matches!(error, ControlError::NotFinite { .. }), "{error}");
        stands(&mut control);
    }
    let error = control.tick(f64::NAN).unwrap_err().to_string();
    assert!(error.contains("seconds is NaN"), "{error}");
}

#[track_caller]
fn stands(control: &mut TwistController) {
    let joints = control.joint_positions().to_vec();
    control.tick(TICK).unwrap();
    assert_eq!(control.joint_positions(), joints);
    assert_eq!(control.current_twist(), Twist::ZERO);
    assert!(control.joint_velocities().iter().all(|&velocity| velocity == 0.0));
}

#[test]
fn the_end_of_the_reach_is_an_error_and_stops_the_arm() {
    for way in [DVec3::X, -DVec3::X, DVec3::Z, -DVec3::Z, DVec3::Y] {
        let mut control = at_work();
        control.command_twist(Twist::from_linear(0.3 * way)).unwrap();
        let stopped = (0..2000).find_map(|_| {
            let command = control.command_twist(Twist::from_linear(0.3 * way));
            command.and_then(|()| control.tick(TICK)).err()
        });
        let error = stopped.unwrap();
        println!("{way}: {error}");
        assert!(matches!(error, ControlError::CannotFollow { .. }), "{error}");
        stands(&mut control);
        // it can go back the way it came
        control.command_twist(Twist::from_linear(-0.05 * way)).unwrap();
        control.tick(TICK).unwrap();
    }
}

#[test]
#[should_panic(expected = "`configuration` has 6 elements, expected 7")]
fn a_configuration_of_another_length_is_named() {
    chain("tool_link").tip_pose(&gen3::WORK_JOINT_POSITIONS[..6]);
}

#[test]
#[should_panic(expected = "`positions` has 7 elements, expected 8")]
fn a_position_vector_of_another_length_is_named() {
    gen3::gen3_description().unwrap().link_poses(&gen3::WORK_JOINT_POSITIONS);
}

#[test]
fn settings_out_of_range_are_refused() {
    type Spoil = fn(&mut TwistControlSettings);
    let spoils: [(Spoil, &str); 9] = [
        (
            |s| s.limits.max_acceleration = 0.0,
            "max_acceleration is 0, expected a positive number up to 1e6",
        ),
        (|s| s.lookahead_s = f64::NAN, "lookahead_s is NaN"),
        (|s| s.lookahead_s = 1e9, "lookahead_s is 1000000000"),
        (|s| s.damping = 1e-200, "damping is 0.000"),
        (|s| s.damping = 1e200, "damping is 1000"),
        (|s| s.correction_rate = 41.0, "correction_rate is 41"),
        (|s| s.posture_rate = -1.0, "posture_rate is -1"),
        (|s| s.posture_rate = 1e300, "posture_rate is 1000"),
        (|s| s.tolerance = f64::INFINITY, "tolerance is inf"),
    ];
    for (spoil, words) in spoils {
        let mut settings = TwistControlSettings::default();
        spoil(&mut settings);
        let error = TwistController::new(chain("tool_link"), &gen3::WORK_JOINT_POSITIONS, settings)
            .unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
}

#[test]
fn postures_out_of_range_are_refused() {
    let mut bent = gen3::WORK_JOINT_POSITIONS;
    bent[1] = 3.0;
    assert!(at_work().restart(&bent).is_err());
}

/// The difference of two positions of a continuous joint may overflow.
#[test]
fn velocities_that_are_not_finite_move_no_joint() {
    let mut posture = gen3::WORK_JOINT_POSITIONS;
    posture[0] = f64::MAX;
    let settings = TwistControlSettings::default();
    let mut control = TwistController::new(chain("tool_link"), &posture, settings).unwrap();
    posture[0] = f64::MIN;
    control.restart(&posture).unwrap();
    let error = control.command_twist(Twist::from_linear(0.1 * DVec3::Y)).unwrap_err();
    assert!(matches!(error, ControlError::NotFinite { .. }), "{error}");
    assert_eq!(control.joint_positions(), posture);
    stands(&mut control);
}

#[test]
fn a_long_tick_is_many_short_ones() {
    let [mut long, mut short] = [at_work(), at_work()];
    for control in [&mut long, &mut short] {
        control.command_twist(Twist::from_linear(0.1 * DVec3::Y)).unwrap();
    }
    long.tick(0.5).unwrap();
    (0..20).for_each(|_| short.tick(0.025).unwrap());
    for (one_tick, many_ticks) in long.joint_positions().iter().zip(short.joint_positions()) {
        assert!((one_tick - many_ticks).abs() < 1e-12, "{one_tick} {many_ticks}");
    }
    let error = long.tick(1e9).unwrap_err().to_string();
    assert!(error.contains("seconds is 1000000000"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 40,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn limits_hold_whatever_is_commanded(seed in any::<u64>()) {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let mut control = at_work();
        let limits = TwistControlSettings::default().limits;
        for _ in 0..10 {
            let mut any = |most: f64| DVec3::from_array(
                std::array::from_fn(|_| generator.random_range(-most..most)),
            );
            let twist = Twist { linear: any(1.0), angular: any(1.0) };
            let commanded = control.command_twist(twist).is_ok();
            for _ in 0..8 {
                let (joints, before) = (control.joint_positions().to_vec(), control.current_twist());
                let moved = control.tick(TICK).is_ok();
                let now = control.current_twist();
                prop_assert!(now.linear.length() <= limits.max_speed + 1e-12);
                prop_assert!(now.angular.length() <= limits.max_angular_speed + 1e-12);
                let faster = now.linear.length() - before.linear.length();
                prop_assert!(faster <= limits.max_acceleration * TICK + 1e-12, "{faster}");
                prop_assert!(commanded || now == Twist::ZERO);
                let rows = control.chain().joints().iter().zip(control.joint_positions());
                let rows = rows.zip(&joints);
                for ((joint, position), earlier) in rows {
                    let (speed, max) = ((position - earlier).abs() / TICK, joint.motion.max_speed);
                    prop_assert!(speed <= max.unwrap() + 1e-9, "{}: {speed}", joint.name);
                    let [low, high] = joint.motion.range.unwrap_or([f64::MIN, f64::MAX]);
                    prop_assert!((low..=high).contains(position));
                }
                if !moved {
                    break;
                }
            }
        }
    }
}

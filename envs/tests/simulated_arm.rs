//! Simulated arm as a robot: twists, latency, faults, the watchdog.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use envs::embodiments::KinovaGen3;
use envs::robots::{ArmCommand, ControlError, Robot, Twist, Watchdog};
use envs::{Camera, Embodiment, HAND_TARGET_START, Placement, Scene, SimulatedArm, TaskGroup};
use glam::{DVec3, Vec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

/// Seconds of a control step.
const STEP: f64 = 0.0125;

fn scene(embodiment: Embodiment) -> Arc<Scene> {
    Arc::new(Scene::new(TaskGroup::GOAL_REACH, embodiment, Camera::default()).unwrap())
}

fn started(latency: f64) -> SimulatedArm {
    let mut arm = SimulatedArm::new(scene(Embodiment::KINOVA_GEN3), latency).unwrap();
    let placement = Placement { object: DVec3::ZERO, goal: DVec3::new(0.1, 0.1, 0.1) };
    arm.start_episode(D2::Identity, placement).unwrap();
    arm
}

fn moving(linear: DVec3, gripper_closure: f64) -> ArmCommand {
    ArmCommand { twist: Twist::from_linear(linear), gripper_closure }
}

fn advance(arm: &mut SimulatedArm, steps: usize) {
    for _ in 0..steps {
        arm.advance().unwrap();
    }
}

#[test]
fn a_twist_moves_the_tip_at_its_speed_and_closes_the_fingers() {
    let mut arm = started(0.0);
    let start = arm.state().unwrap();
    assert!(start.tip.position.distance(HAND_TARGET_START) < 1e-4 && start.gripper_closure < 1e-3);
    arm.command(&moving(0.1 * DVec3::X, 1.0)).unwrap();
    advance(&mut arm, 80);
    let state = arm.state().unwrap();
    let way = state.tip.position - start.tip.position;
    // a second, less half of the 50 ms in which it speeds up, and the lag of its servos
    assert!((0.09..0.1).contains(&way.x) && way.y.abs() < 0.003 && way.z.abs() < 0.003, "{way}");
    assert!(state.gripper_closure > 0.95, "{}", state.gripper_closure);
    let hand = arm.environment().hand_position();
    assert!(hand.distance(state.tip.position) < 1e-6, "its joints tell where it is");
    arm.stop().unwrap();
    advance(&mut arm, 40);
    let stopped = arm.state().unwrap().tip.position;
    advance(&mut arm, 40);
    assert!(arm.state().unwrap().tip.position.distance(stopped) < 1e-4);
}

/// Observations and details must be those of the command that moves the arm, not of its start.
#[test]
fn the_environment_knows_the_fingers_and_the_target_of_the_arm() {
    let scene = Scene::new(TaskGroup::DRAWER_CLOSE, Embodiment::KINOVA_GEN3, Camera::default());
    let mut arm = SimulatedArm::new(Arc::new(scene.unwrap()), 0.0).unwrap();
    let placement = arm.environment().scene().sample_placement(&mut ChaCha8Rng::seed_from_u64(0));
    arm.start_episode(D2::Identity, placement).unwrap();
    arm.command(&moving(0.1 * DVec3::Z, 1.0)).unwrap();
    advance(&mut arm, 9);
    let reward = arm.advance().unwrap();
    assert!(reward.approach_reward > 0.0, "the fingers still close: {reward:?}");
    let table = arm.environment();
    let [.., approach, in_place, distance] = table.state_details().unwrap();
    let terms = [reward.approach_reward, reward.in_place_reward, reward.goal_distance];
    assert_eq!([approach, in_place, distance], terms.map(|term| term as f32));
    let risen = table.hand_position().distance(HAND_TARGET_START);
    let [.., x, y, z] = table.observe().unwrap();
    let lead = Vec3::new(x, y, z).length();
    assert!(risen > 5e-3 && lead < 2e-3, "{risen} {lead}");
}

/// With a latency the same must happen, the given number of control steps later.
#[test]
fn latency_shifts_what_is_commanded_and_nothing_else() {
    let way = |latency| {
        let mut arm = started(latency);
        arm.command(&moving(DVec3::new(0.1, -0.1, 0.0), 0.3)).unwrap();
        let place = |_| {
            advance(&mut arm, 1);
            arm.state().unwrap().tip.position
        };
        (0..30).map(place).collect::<Vec<_>>()
    };
    let (now, later) = (way(0.0), way(0.06));
    // 60 ms are five control steps; the arm at rest trembles by micrometres
    for (i, place) in now[..20].iter().enumerate() {
        let off = place.distance(later[i + 5]);
        assert!(off < 1e-5, "{i}: {off}");
    }
    assert!(
        later[4].distance(HAND_TARGET_START) < 1e-4 && now[4].distance(HAND_TARGET_START) > 1e-3
    );
}

#[test]
fn an_arm_that_cannot_follow_says_so_and_stands() {
    for latency in [0.0, 0.05] {
        let mut arm = started(latency);
        arm.command(&moving(0.5 * DVec3::ONE, 0.0)).unwrap();
        let fault = (0..400).find_map(|_| {
            advance(&mut arm, 1);
            arm.state().err()
        });
        assert!(matches!(fault, Some(ControlError::CannotFollow { .. })), "{fault:?}");
        advance(&mut arm, 40);
        let stands = arm.state().unwrap().tip.position;
        advance(&mut arm, 40);
        assert!(arm.state().unwrap().tip.position.distance(stands) < 1e-3);
        // and comes back
        arm.command(&moving(-0.2 * DVec3::ONE, 0.0)).unwrap();
        advance(&mut arm, 40);
        assert!(arm.state().unwrap().tip.position.distance(stands) > 0.05);
    }
}

#[test]
fn nonsense_is_refused_and_stops_the_arm() {
    let mut arm = started(0.0);
    arm.command(&moving(0.1 * DVec3::X, 0.0)).unwrap();
    advance(&mut arm, 20);
    assert!(arm.command(&moving(DVec3::NAN, 0.0)).is_err());
    assert!(arm.command(&moving(DVec3::X, 2.0)).is_err());
    advance(&mut arm, 40);
    let stands = arm.state().unwrap().tip.position;
    advance(&mut arm, 20);
    assert!(arm.state().unwrap().tip.position.distance(stands) < 1e-4);

    let welded = SimulatedArm::new(scene(Embodiment::SAWYER), 0.0).err().unwrap();
    assert!(welded.to_string().contains("`embodiment` is sawyer"), "{welded}");
    let late = SimulatedArm::new(scene(Embodiment::KINOVA_GEN3), f64::NAN).err().unwrap();
    assert!(late.to_string().contains("`latency` is NaN"), "{late}");
    let mut nowhere = SimulatedArm::new(scene(Embodiment::KINOVA_GEN3), 0.0).unwrap();
    assert!(nowhere.state().is_err() && nowhere.command(&moving(DVec3::X, 0.0)).is_err());
    assert!(nowhere.advance().is_err());
}

#[test]
fn a_watchdog_stops_an_arm_that_nobody_commands() {
    let clock = Rc::new(Cell::new(Duration::ZERO));
    let time = Rc::clone(&clock);
    let mut arm = Watchdog::new(started(0.0), move || time.get());
    arm.command(&moving(0.1 * DVec3::X, 0.0)).unwrap();
    let mut places = Vec::new();
    for step in 1..=60 {
        advance(arm.robot_mut(), 1);
        clock.set(Duration::from_secs_f64(f64::from(step) * STEP));
        places.push(arm.state().unwrap().tip.position);
    }
    // 200 ms are 16 steps
    assert!(places[15].distance(places[10]) > 4e-3);
    assert!(places[59].distance(places[45]) < 1e-4);
    let way = places[59].distance(HAND_TARGET_START);
    assert!((0.01..0.025).contains(&way), "{way}");
}

/// The capsules of the arm's reported state must contain its geoms.
#[test]
fn capsules_follow_the_joints_that_the_arm_tells() {
    let mut arm = started(0.0);
    arm.command(&moving(DVec3::new(0.2, 0.1, -0.1), 1.0)).unwrap();
    advance(&mut arm, 30);
    let capsules = KinovaGen3.arm().unwrap().capsules(&arm.state().unwrap());
    let data = arm.environment().simulation();
    let model = data.model();
    let mut seen = 0;
    for geom in model.geoms().filter(|&geom| model.geom_group(geom) == envs::ARM_GEOM_GROUP) {
        let middle = DVec3::from_array(data.geom_position(geom));
        let inside = capsules.iter().map(|capsule| capsule.signed_distance_to_point(middle));
        let inside = inside.fold(f64::INFINITY, f64::min);
        assert!(inside < 0.0, "{:?}: {inside}", model.name_of(geom));
        seen += 1;
    }
    assert!(seen >= 10 && capsules.len() == seen, "{seen} {}", capsules.len());
}

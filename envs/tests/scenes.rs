//! Compiled scenes: names, masses, springs.

use std::sync::Arc;

use envs::{
    Camera, ControlSettings, Embodiment, HAND_TARGET_START, Layout, Scene, TableTop, TaskGroup,
};
use mujoco::Data;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

fn scene(group: TaskGroup, embodiment: Embodiment) -> Scene {
    Scene::new(group, embodiment, Camera::default()).unwrap()
}

/// The conformance rules check the same with the standard embodiments.
#[test]
fn everything_in_every_scene_of_the_kinova_has_a_name() {
    for layout in Layout::ALL {
        for group in TaskGroup::ALL {
            let embodiment = Embodiment::KINOVA_GEN3;
            let scene = Scene::new_in_layout(layout, group, embodiment, Camera::default()).unwrap();
            let unnamed = scene.model.unnamed_objects();
            assert!(unnamed.is_empty(), "{layout}, {group}: {unnamed:?}");
            assert_eq!(scene.model.compile_warning(), None, "{layout}, {group}");
        }
    }
}

/// Both hands hang 31.2 N on a weld of 8190 N/m and sink by 3.81 mm; the arm at this height by 3.77
/// mm, and it leans 0.24 mm back.
#[test]
fn hands_rest_below_their_target() {
    for embodiment in Embodiment::STANDARD {
        let scene = scene(TaskGroup::GOAL_REACH, embodiment);
        let mut data = Data::new(Arc::clone(&scene.model));
        data.restore_state(scene.start_state(D2::Identity)).unwrap();
        data.forward_kinematics().unwrap();
        let hand = data.body_position(scene.model.body("hand").unwrap());
        let sag = HAND_TARGET_START - glam::DVec3::from_array(hand);
        assert!((sag.z - 3.81e-3).abs() < 5e-5, "{embodiment}: {sag}");
        assert!(sag.truncate().length() < 5e-4, "{embodiment}: {sag}");
        let speeds = data.qvel();
        assert!(speeds.iter().all(|v| v.abs() < 1e-4), "{embodiment} moves at {speeds:?}");
    }
}

/// A mass on a spring and damper under its own damping: the same forces move both hands, so both
/// respond equally to a step of the target.
#[test]
fn the_hand_follows_its_target_as_the_arm_does() {
    let follow = |embodiment| {
        let scene = scene(TaskGroup::GOAL_REACH, embodiment);
        let mut data = Data::new(Arc::clone(&scene.model));
        data.restore_state(scene.start_state(D2::Identity)).unwrap();
        let (target, hand) =
            (scene.model.mocap_body("hand_target").unwrap(), scene.model.body("hand").unwrap());
        let mut lags = Vec::new();
        for step in 1..=40 {
            let x = 0.004 * f64::from(step);
            data.set_mocap_position(target, [x, 0.0, HAND_TARGET_START.z]).unwrap();
            data.step(5).unwrap();
            data.forward_kinematics().unwrap();
            lags.push(x - data.body_position(hand)[0]);
        }
        lags
    };
    let (arm, hand) = (follow(Embodiment::SAWYER), follow(Embodiment::FLOATING_HAND));
    // at 0.32 m/s: 12 mm by the weld's damper and 1 to 5 mm by the damping of what it pulls
    for (step, (arm_at, hand_at)) in arm.iter().zip(&hand).enumerate() {
        assert!((arm_at - hand_at).abs() < 4e-3, "step {step}: {arm_at} and {hand_at}");
    }
    assert!((0.012..0.020).contains(&hand[39]), "{}", hand[39]);
}

/// The hand's collision masks leave out the walls, which must be out of its reach.
#[test]
fn the_hand_cannot_reach_the_walls() {
    let scene = Arc::new(scene(TaskGroup::GOAL_REACH, Embodiment::FLOATING_HAND));
    let model = &scene.model;
    let inside = |wall: &str, axis: usize| {
        let wall = model.geom(wall).unwrap();
        let (mut data, half) = (Data::new(Arc::clone(model)), model.geom_size(wall)[axis]);
        data.forward_kinematics().unwrap();
        data.geom_position(wall)[axis].abs() - half
    };
    let walls = [inside("wall_right", 0), inside("wall_far", 1)];
    let mut table = TableTop::new(Arc::clone(&scene), ControlSettings::default()).unwrap();
    for corner in D2::ALL {
        table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
        let [x, y] = corner.apply_xy([1.0, 1.0]);
        let mut furthest = [0.0_f64; 2];
        for _ in 0..20 {
            table.step(&[x as f32, y as f32, -1.0, -1.0]).unwrap();
            for ball in model.geoms().filter(|&geom| model.geom_group(geom) == 3) {
                let (place, radius) =
                    (table.simulation().geom_position(ball), model.geom_size(ball)[0]);
                for axis in 0..2 {
                    furthest[axis] = furthest[axis].max(place[axis].abs() + radius);
                }
            }
        }
        assert!(furthest[0] > 0.3 && furthest[1] > 0.34, "{corner}: only {furthest:?}");
        assert!(furthest[0] < walls[0] && furthest[1] < walls[1], "{corner}: {furthest:?}");
    }
}

/// A slammed drawer must overshoot by a centimetre at most before the wall holds it, with either
/// embodiment. The limit of its joint alone would allow 5 cm.
#[test]
fn a_shut_drawer_stands_against_the_wall() {
    for embodiment in Embodiment::STANDARD {
        let scene = Arc::new(scene(TaskGroup::DRAWER_CLOSE, embodiment));
        let slide = scene.model.joint_qpos_address(scene.model.joint("slide").unwrap());
        let mut table = TableTop::new(Arc::clone(&scene), ControlSettings::default()).unwrap();
        for element in D2::ALL {
            table.reset(element, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
            let mut furthest = f64::NEG_INFINITY;
            for _ in 0..50 {
                let action = table.expert_action().unwrap();
                table.step(&action).unwrap();
                furthest = furthest.max(table.simulation().qpos()[slide]);
            }
            assert!((-0.002..0.015).contains(&furthest), "{embodiment} {element}: {furthest}");
        }
    }
}

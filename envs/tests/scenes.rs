//! The compiled scenes themselves: names, masses, springs.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::sync::Arc;

use envs::{Camera, Embodiment, HAND_START, Layout, Scene, TaskGroup};
use mujoco::Data;

fn scene(group: TaskGroup, embodiment: Embodiment) -> Scene {
    Scene::new(group, embodiment, Camera::default()).unwrap()
}

#[test]
fn everything_in_every_scene_has_a_name() {
    for layout in Layout::ALL {
        for embodiment in Embodiment::ALL {
            for group in TaskGroup::ALL {
                let scene = Scene::in_layout(layout, group, embodiment, Camera::default()).unwrap();
                let unnamed = scene.model.unnamed();
                let warning = scene.model.warning();
                assert!(
                    unnamed.is_empty(),
                    "{layout}, {embodiment}, {group}: {unnamed:?}"
                );
                assert_eq!(warning, None, "{layout}, {embodiment}, {group}");
            }
        }
    }
}

/// Both hang 31.2 N on a weld of 8190 N/m and sink by 3.81 mm; the arm at this height by 3.77 mm, and leans 0.24 mm back.
#[test]
fn hands_rest_below_their_target() {
    for embodiment in Embodiment::ALL {
        let scene = scene(TaskGroup::GoalReach, embodiment);
        let mut data = Data::new(Arc::clone(&scene.model));
        data.restore(scene.settled()).unwrap();
        data.forward_kinematics().unwrap();
        let hand = data.body_position(scene.model.body("hand").unwrap());
        let sag = HAND_START - glam::DVec3::from_array(hand);
        assert!((sag.z - 3.81e-3).abs() < 5e-5, "{embodiment}: {sag}");
        assert!(sag.truncate().length() < 5e-4, "{embodiment}: {sag}");
        let fastest = data.qvel().iter().fold(0.0_f64, |max, v| max.max(v.abs()));
        assert!(fastest < 1e-4, "{embodiment} moves at {fastest}");
    }
}

/// A mass on a spring and damper under its own damping: the same forces move both hands, so a step of the target takes them alike.
#[test]
fn the_hand_follows_its_target_as_the_arm_does() {
    let follow = |embodiment| {
        let scene = scene(TaskGroup::GoalReach, embodiment);
        let mut data = Data::new(Arc::clone(&scene.model));
        data.restore(scene.settled()).unwrap();
        let (target, hand) = (
            scene.model.mocap("hand_target").unwrap(),
            scene.model.body("hand").unwrap(),
        );
        let mut lags = Vec::new();
        for step in 1..=40 {
            let x = 0.004 * f64::from(step);
            data.set_mocap_position(target, [x, 0.0, HAND_START.z])
                .unwrap();
            data.step(5).unwrap();
            data.forward_kinematics().unwrap();
            lags.push(x - data.body_position(hand)[0]);
        }
        lags
    };
    let (arm, hand) = (follow(Embodiment::Sawyer), follow(Embodiment::Hand));
    // at 0.32 m/s: 12 mm by the weld's damper and 1 to 5 mm by the damping of what it pulls
    for (step, (arm, hand)) in arm.iter().zip(&hand).enumerate() {
        assert!((arm - hand).abs() < 4e-3, "step {step}: {arm} and {hand}");
    }
    assert!((0.012..0.020).contains(&hand[39]), "{}", hand[39]);
}

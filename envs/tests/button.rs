//! Meta-World's reward while a claw presses the button.

use std::sync::Arc;

use envs::{Camera, ControlSettings, Embodiment, Scene, TableTop, TaskGroup};
use glam::DVec3;
use mujoco::is_reference_release;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

#[derive(Debug)]
struct Press {
    /// Remaining travel (metres).
    goal_distance: f64,
    reward: f64,
    success: bool,
}

/// Travel of the cap from rest to its goal (metres).
const TRAVEL: f64 = 0.0935;
/// Remaining travel at success (metres).
const SUCCESS: f64 = 0.02;

/// Aligns the hand with the button at 4 cm a decision, then pushes by 2 cm a decision with the
/// finger action `finger`. Returns the decisions in which the cap is off its rest.
fn presses(embodiment: Embodiment, finger: f32, seed: u64) -> Vec<Press> {
    let scene = Scene::new(TaskGroup::BUTTON_PRESS, embodiment, Camera::default());
    let mut env = TableTop::new(Arc::new(scene.unwrap()), ControlSettings::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    env.reset(D2::Identity, &mut rng).unwrap();
    let rest = env.task_state().unwrap().object;
    let (mut pushing, mut presses) = (false, Vec::new());
    for _ in 0..50 {
        let now = env.task_state().unwrap();
        let to = rest + (now.hand - now.tcp) - DVec3::Y * 0.08 - now.hand;
        pushing |= to.x.abs().max(to.z.abs()) < 0.006;
        let move_by =
            if pushing { DVec3::Y / 2.0 } else { (to / 0.04).clamp(DVec3::NEG_ONE, DVec3::ONE) };
        let [x, y, z] = move_by.as_vec3().to_array();
        let outcome = env.step(&[x, y, z, finger]).unwrap();
        let way = (env.task_state().unwrap().object.y - rest.y).abs();
        if way > 0.002 {
            presses.push(Press {
                goal_distance: TRAVEL - way,
                reward: outcome.reward,
                success: outcome.success,
            });
        }
    }
    presses
}

/// Embodiments whose presses the tests measure, each with the travel (metres) that remains where
/// closed fingers stop.
const CASES: [(Embodiment, f64); 2] =
    [(Embodiment::SAWYER, 0.029), (Embodiment::FLOATING_HAND, 0.034)];

/// Returns all cases with MuJoCo 2.2.2. With MuJoCo 3 the arm's contacts yield more: closed fingers
/// succeed, too, and an open claw pushes the cap beyond its travel.
fn cases() -> &'static [(Embodiment, f64)] {
    if is_reference_release() { &CASES } else { &CASES[1..] }
}

#[test]
fn closed_fingers_are_paid_for_every_millimetre_and_stop_short_of_success() {
    for &(embodiment, stop) in cases() {
        for seed in 0..5 {
            let presses = presses(embodiment, 0.5, seed);
            let rising = presses.is_sorted_by(|a, b| a.reward < b.reward + 1e-3);
            assert!(rising && presses[0].reward < 0.18, "{seed}: {presses:?}");
            let last = &presses[presses.len() - 1];
            assert!((0.45..0.58).contains(&last.reward), "{seed}: {last:?}");
            let short = (last.goal_distance - stop).abs() < 1e-3 && last.goal_distance > SUCCESS;
            assert!(short, "{embodiment}, {seed}: {last:?}");
            assert!(presses.iter().all(|press| !press.success), "{seed}");
        }
    }
}

#[test]
fn an_open_claw_is_paid_for_every_millimetre_until_it_succeeds() {
    for &(embodiment, _) in cases() {
        for seed in 0..5 {
            let presses = presses(embodiment, -0.2, seed);
            let success = presses.iter().position(|press| press.success);
            let way = &presses[..=success.unwrap()];
            let rising = way.is_sorted_by(|a, b| a.reward < b.reward);
            assert!(rising && way[0].reward > 0.25, "{seed}: {presses:?}");
            let last = &presses[presses.len() - 1];
            assert!(last.reward > 0.85, "{embodiment}, {seed}: {last:?}");
        }
    }
}

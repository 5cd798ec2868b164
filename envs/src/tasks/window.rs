//! Window Open and Window Close: slide the pane of a window by its handle, along +x or -x.

use std::ops::Range;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::caging::{come_down, is_down_at};
use super::{META_WORLD_HAND_BACK, META_WORLD_X, draw_at, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of sliding a window open.
#[derive(Clone, Copy, Debug)]
pub struct WindowOpen;

/// Task of sliding a window shut.
#[derive(Clone, Copy, Debug)]
pub struct WindowClose;

/// Travel of the pane (metres): joint 0 is shut, this is open.
const TRAVEL: f64 = 0.2;
/// Offset from the pane's origin to the side of the handle that opens the window (metres).
const OPENING_SIDE: DVec3 = DVec3::new(-0.04, -0.095, 0.0);
/// Offset from the pane's origin to the side of the handle that shuts the window (metres).
const CLOSING_SIDE: DVec3 = DVec3::new(0.01, -0.095, 0.0);
/// Distance of the handle from its target along x at full reward and at success (metres).
const SUCCESS: f64 = 0.05;
/// Radius of the handle (metres).
const HANDLE_RADIUS: f64 = 0.02;

/// Distance at which the expert stops (metres): an open pane stands 0.04 m from its target.
const NEAR_ENOUGH: f64 = 0.043;

/// Range of the window along x (metres): the pane's way is off the centre, too.
const WINDOW_X: Range<f64> = 0.01..0.06;
/// Range of the window along y (metres).
const WINDOW_Y: Range<f64> = 0.18..0.24;
/// Height of the window's centre (metres): low, so that a wrist passes above it.
const WINDOW_Z: f64 = 0.11;

/// Range along y of Meta-World's window that is to be opened (metres).
const META_WORLD_OPEN_Y: Range<f64> = 0.1..0.3;
/// Height of Meta-World's window that is to be opened (metres).
const META_WORLD_OPEN_Z: f64 = 0.16;
/// Range along y of Meta-World's window that is to be shut (metres).
const META_WORLD_CLOSE_Y: Range<f64> = 0.15..0.3;
/// Height of Meta-World's window that is to be shut (metres).
const META_WORLD_CLOSE_Z: f64 = 0.2;

impl Task for WindowOpen {
    fn name(&self) -> &str {
        "window-open"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place_shut(draw_window(rng))
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let Placement { object, goal } = start.placement;
        let [distance, margin] = distances_from_handle(start, now);
        let reached = long_tail_reward(distance, HANDLE_RADIUS, margin);
        // as in Meta-World, the margin begins at the window, not at the handle
        sliding_reward(now, goal, (object.x - goal.x).abs(), reached)
    }

    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        push(placement, now, -1.0)
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts { handed: true, ..scene(part!("window.xml").1, "window", OPENING_SIDE) }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_BACK,
            ..spec("window-open", |rng| {
                let y = META_WORLD_OPEN_Y;
                place_shut(draw_at(META_WORLD_OPEN_Z, [META_WORLD_X, y], rng))
            })
        })
    }
}

impl Task for WindowClose {
    fn name(&self) -> &str {
        "window-close"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place_open(draw_window(rng))
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let goal = start.placement.goal;
        let [distance, margin] = distances_from_handle(start, now);
        let reached = gaussian_reward(distance, HANDLE_RADIUS, margin);
        sliding_reward(now, goal, (start.task_state.object.x - goal.x).abs(), reached)
    }

    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        push(placement, now, 1.0)
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            handed: true,
            start_joints: &[("slide", TRAVEL)],
            ..scene(part!("window.xml").1, "window", CLOSING_SIDE)
        }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_BACK,
            // the only range along x is a point
            ..spec("window-close", |rng| {
                place_open(DVec3::new(0.0, uniform(rng, META_WORLD_CLOSE_Y), META_WORLD_CLOSE_Z))
            })
        })
    }
}

fn draw_window(rng: &mut ChaCha8Rng) -> DVec3 {
    draw_at(WINDOW_Z, [WINDOW_X, WINDOW_Y], rng)
}

/// Returns the placement of a shut window, which is to be opened.
fn place_shut(object: DVec3) -> Placement {
    Placement { object, goal: object + TRAVEL * DVec3::X }
}

/// Returns the placement of an open window, which is to be shut.
fn place_open(object: DVec3) -> Placement {
    Placement { object, goal: object }
}

/// Returns the distance of the fingertips from the handle, and its margin (metres).
fn distances_from_handle(start: &EpisodeStart, now: &TaskState) -> [f64; 2] {
    let begun = &start.task_state;
    let margin = (begun.object.distance(begun.tcp) - HANDLE_RADIUS).abs();
    [now.object.distance(now.tcp), margin]
}

/// Returns the reward of a pane whose handle was `at_start` from its target along x (metres).
fn sliding_reward(now: &TaskState, goal: DVec3, at_start: f64, reached: f64) -> StepReward {
    let goal_distance = (now.object.x - goal.x).abs();
    let placed = long_tail_reward(goal_distance, SUCCESS, (at_start - SUCCESS).abs());
    StepReward {
        approach_reward: reached,
        in_place_reward: placed,
        goal_distance,
        reward: 10.0 * hamacher_product(reached, placed),
        success: goal_distance <= SUCCESS,
    }
}

/// Comes down beside the handle, on its left (`side` -1) or right (1), and pushes it away until it
/// is near its target.
fn push(placement: &Placement, now: &TaskState, side: f64) -> ExpertCommand {
    let aim = now.object + DVec3::new(0.01 * side, 0.0, 0.02);
    let ahead = (now.hand.x - aim.x) * side;
    let in_line = (now.hand.y - aim.y).abs() < 0.02 && (-0.03..0.25).contains(&ahead);
    // once it pushes, the hand goes on although it lags behind the handle
    let pushes = in_line && is_down_at(now.hand, aim, f64::INFINITY);
    let hand = match come_down(now.hand, aim, 0.12) {
        Some(hand) if !pushes => hand,
        _ => {
            let left = (now.object.x - placement.goal.x).abs() - NEAR_ENOUGH;
            // a lead of at most 8 cm: more would tear past the handle at the end of its way
            aim - DVec3::new(left.clamp(0.0, 0.08) * side, 0.0, 0.0)
        }
    };
    ExpertCommand { hand, finger: 1.0 }
}

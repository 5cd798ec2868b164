//! Drawer Close and Drawer Open: push an open drawer shut along +y, or pull a shut one open.

use std::ops::Range;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::caging::{come_down, is_down_at};
use super::{CANONICAL_X, META_WORLD_X, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of pushing a drawer shut.
#[derive(Clone, Copy, Debug)]
pub struct DrawerClose;

/// Task of pulling a drawer open.
#[derive(Clone, Copy, Debug)]
pub struct DrawerOpen;

/// Position of the case along y in Meta-World, and of one that starts open (metres).
const CASE_Y: f64 = 0.3;
/// Position along y of the case of a drawer that starts shut (metres): nearer, so that its handle
/// is within the arm's symmetric reach.
const SHUT_CASE_Y: f64 = 0.26;
/// Joint position of the open drawer (metres); 0 is closed.
const OPEN: f64 = -0.15;
/// Offset from the case's origin to the handle of a shut drawer (metres).
const SHUT: DVec3 = DVec3::new(0.0, -0.16, 0.09);
/// Offset from the drawer body's origin to its handle (metres).
const HANDLE: DVec3 = DVec3::new(0.0, -0.16, 0.0);
/// Offset from the drawer body's origin to the point above its handle that Drawer Close measures
/// (metres). Its target is the handle itself, so the distance is never below 0.05.
const ABOVE_HANDLE: DVec3 = DVec3::new(0.0, -0.16, 0.05);

/// Distance of that point from its target at full reward of Drawer Close (metres).
const CLOSE_BOUND: f64 = 0.05;
/// Distance of that point from its target at success of Drawer Close (metres).
const CLOSE_SUCCESS: f64 = 0.065;
/// Distance of the fingertips from that point that counts as touching (metres).
const TOUCHING: f64 = 0.005;

/// Way of the handle of Drawer Open to its target (metres).
const WAY: f64 = 0.17;
/// [`WAY`] in Meta-World (metres): to 4 cm beyond the stop, against which the hand must pull.
const META_WORLD_WAY: f64 = 0.2;
/// Distance of the handle from its target at full reward of Drawer Open (metres).
const OPEN_BOUND: f64 = 0.02;
/// Distance of the handle from its target at success of Drawer Open (metres).
const OPEN_SUCCESS: f64 = 0.03;
/// Weights of the hand's distance from the handle along the axes: the hand may be high, but not
/// beside it.
const WEIGHTS: DVec3 = DVec3::new(3.0, 3.0, 1.0);
/// Weighted distance of the hand from the handle at full reward (metres).
const CAGED: f64 = 0.01;

impl Task for DrawerClose {
    fn name(&self) -> &str {
        "drawer-close"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_case(rng, CANONICAL_X, CASE_Y), 0.0)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let EpisodeStart { placement, task_state, .. } = start;
        let goal_distance = now.object.distance(placement.goal);
        let at_start = task_state.object.distance(placement.goal);
        let shut = long_tail_reward(goal_distance, CLOSE_BOUND, (at_start - CLOSE_BOUND).abs());
        let margin = (task_state.object.distance(task_state.tcp) - TOUCHING).abs();
        let reached = gaussian_reward(now.object.distance(now.tcp), TOUCHING, margin);
        let success = goal_distance <= CLOSE_SUCCESS;
        // closed fingers push better than a claw that may slip over the handle
        let pushing = hamacher_product(reached, finger.clamp(0.0, 1.0));
        StepReward {
            approach_reward: pushing,
            in_place_reward: shut,
            goal_distance,
            // the full reward at success, although the distance never vanishes
            reward: if success { 10.0 } else { 10.0 * hamacher_product(pushing, shut) },
            success,
        }
    }

    /// Moves up and over to the near side of the handle, down, then pushes.
    fn expert(&self, _: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, 0.0, -0.02);
        let near_side = aim + DVec3::new(0.0, -0.075, 0.0);
        // above or behind the handle the way down would end on the drawer
        let hand = if now.hand.y > aim.y - 0.05 && (now.hand.z - aim.z) > 0.04 {
            if now.hand.z < aim.z + 0.10 {
                now.hand + DVec3::new(0.0, -0.02, 0.5)
            } else {
                near_side + DVec3::new(0.0, 0.0, 0.13)
            }
        } else if (now.hand.z - aim.z).abs() > 0.04 {
            near_side
        } else {
            aim + DVec3::new(0.0, 0.05, 0.0)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            start_joints: &[("slide", OPEN)],
            ..scene(part!("drawer.xml").1, "drawer", ABOVE_HANDLE)
        }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("drawer-close", |rng| place(draw_case(rng, META_WORLD_X, CASE_Y), 0.0)))
    }
}

impl Task for DrawerOpen {
    fn name(&self) -> &str {
        "drawer-open"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_case(rng, CANONICAL_X, SHUT_CASE_Y), WAY)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let EpisodeStart { placement, task_state, .. } = start;
        let goal_distance = now.object.distance(placement.goal);
        let shut = placement.object + SHUT;
        let opened = long_tail_reward(goal_distance, OPEN_BOUND, placement.goal.distance(shut));
        let off = ((now.object - now.hand) * WEIGHTS).length();
        // as in Meta-World, the margin begins at the fingertips, not at the hand
        let margin = ((shut - task_state.tcp) * WEIGHTS).length();
        let caged = long_tail_reward(off, CAGED, margin);
        StepReward {
            approach_reward: caged,
            in_place_reward: opened,
            goal_distance,
            reward: 5.0 * (caged + opened),
            success: goal_distance <= OPEN_SUCCESS,
        }
    }

    /// Comes down around the bar of the handle with open fingers, then pulls.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, 0.008, 0.02);
        let hand = if is_down_at(now.hand, aim, 0.045) {
            // 8 cm ahead pulls hard enough; beyond the goal the drawer would meet its stop
            let y = (aim.y - 0.08).max(placement.goal.y);
            DVec3::new(aim.x, y, aim.z)
        } else {
            come_down(now.hand, aim, 0.09).unwrap_or(aim)
        };
        ExpertCommand { hand, finger: -1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        scene(part!("drawer.xml").1, "drawer", HANDLE)
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("drawer-open", |rng| place(draw_case(rng, META_WORLD_X, CASE_Y), META_WORLD_WAY)))
    }
}

fn draw_case(rng: &mut ChaCha8Rng, x: Range<f64>, y: f64) -> DVec3 {
    DVec3::new(uniform(rng, x), y, 0.0)
}

/// Returns the placement of a case whose drawer should be open by `way` (metres).
fn place(case: DVec3, way: f64) -> Placement {
    Placement { object: case, goal: case + SHUT - way * DVec3::Y }
}

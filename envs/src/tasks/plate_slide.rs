//! Plate Slide: push a puck from the centre into a goal cage that opens to -y.

use std::ops::Range;

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_X, draw_at, scene, spec};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of sliding a plate (puck) into a goal cage.
#[derive(Clone, Copy, Debug)]
pub struct PlateSlide;

/// Range of the goal along y, in Meta-World, too (metres).
const GOAL_Y: Range<f64> = 0.25..0.30;
/// Start of the puck's centre (metres).
const PUCK_START: DVec3 = DVec3::new(0.0, 0.0, 0.015);
/// Puck's start on the table's surface; Meta-World measures from here, not from the puck's centre.
const START_ON_TABLE: DVec3 = DVec3::ZERO;
/// Distance of the puck from its goal at full reward, and of the fingertips from the puck
/// (metres).
const BOUND: f64 = 0.05;
/// Distance of the puck from its goal at success (metres).
const SUCCESS: f64 = 0.07;

/// Bounds (x, y; metres) on the goal's distance from the expert's puck: nearer than `y` along y and
/// farther than `x` along x, a diagonal push would hit the cage's post.
const POST: DVec2 = DVec2::new(0.045, 0.17);
/// Step along y of the expert's aim while the hand must first move sideways (metres).
const SLOW_STEP: f64 = 0.01;

impl Task for PlateSlide {
    fn name(&self) -> &str {
        "plate-slide"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(CANONICAL_X, rng)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let goal = start.placement.goal;
        let goal_distance = now.object.distance(goal);
        // as in Meta-World, margins count from the start on the table
        let margin = START_ON_TABLE.distance(goal);
        let placed = long_tail_reward(goal_distance, BOUND, margin);
        let touching = long_tail_reward(
            now.tcp.distance(now.object),
            BOUND,
            start.task_state.tcp.distance(START_ON_TABLE),
        );
        StepReward {
            approach_reward: touching,
            in_place_reward: placed,
            goal_distance,
            reward: if goal_distance < BOUND {
                10.0
            } else {
                8.0 * hamacher_product(touching, placed)
            },
            success: goal_distance <= SUCCESS,
        }
    }

    /// Goes behind the puck on the line from the goal, down, then pushes towards the goal.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, -0.055, 0.03);
        let off = (now.hand - aim).truncate().length();
        // over the place behind the puck, then down, then forward
        let hand = if off > 0.03 {
            aim + DVec3::new(0.0, 0.0, 0.1)
        } else if (now.hand.z - aim.z).abs() > 0.04 {
            aim
        } else {
            let ahead = placement.goal - now.object;
            // a puck that comes along the diagonal would meet the post of the cage
            let post = ahead.y < POST.y && ahead.x.abs() > POST.x;
            let y = if post { now.hand.y + SLOW_STEP } else { placement.goal.y };
            DVec3::new(placement.goal.x, y, aim.z)
        };
        ExpertCommand { hand, finger: -1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        scene(part!("plate_slide.xml").1, "puck", DVec3::ZERO)
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("plate-slide", |rng| place(META_WORLD_X, rng)))
    }
}

fn place(goal_x: Range<f64>, rng: &mut ChaCha8Rng) -> Placement {
    Placement { object: PUCK_START, goal: draw_at(0.0, [goal_x, GOAL_Y], rng) }
}

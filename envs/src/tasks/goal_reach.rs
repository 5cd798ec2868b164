//! Goal Reach: move the fingertips to a point that the vector observation contains and pictures do
//! not show.

use std::ops::Range;

use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_X, draw_apart, draw_at, draw_in, hand_for_tips, spec};
use crate::mjcf::part;
use crate::reward::long_tail_reward;
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of moving the fingertips to a goal; its scene is the bare table.
#[derive(Clone, Copy, Debug)]
pub struct GoalReach;

/// Distance of the fingertips from the goal at success (metres).
const RADIUS: f64 = 0.05;
/// Range of the goal along y (metres).
const GOAL_Y: Range<f64> = 0.08..0.18;
/// Range of the goal's height (metres).
const GOAL_Z: Range<f64> = 0.08..0.25;

/// Range of Meta-World's goal along y (metres).
const META_WORLD_GOAL_Y: Range<f64> = 0.2..0.3;
/// Range of the height of Meta-World's goal (metres).
const META_WORLD_GOAL_Z: Range<f64> = 0.05..0.3;
/// Smallest distance of Meta-World's loose cylinder from the goal (metres).
const MIN_DISTANCE: f64 = 0.15;
/// Height of the loose cylinder (metres).
const DECOY_Z: f64 = 0.02;
/// Range of the loose cylinder along y (metres).
const DECOY_Y: Range<f64> = 0.0..0.1;

impl Task for GoalReach {
    fn name(&self) -> &str {
        "goal-reach"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let goal = draw_in([CANONICAL_X, GOAL_Y, GOAL_Z], rng);
        // nothing is placed; the object is the goal, so that it lies in the same quadrant
        Placement { object: goal, goal }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let goal = start.placement.goal;
        let distance = now.tcp.distance(goal);
        let margin = start.hand_target.distance(goal);
        let in_place_reward = long_tail_reward(distance, RADIUS, margin);
        StepReward {
            // there is no object to approach
            approach_reward: 1.0,
            in_place_reward,
            goal_distance: distance,
            reward: 10.0 * in_place_reward,
            success: distance <= RADIUS,
        }
    }

    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        ExpertCommand { hand: hand_for_tips(now, placement.goal), finger: 0.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts { goal_observable: true, ..TaskSceneParts::default() }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            extra_mjcf: Some(part!("decoy.xml" in "metaworld").1),
            ..spec("reach", place_meta_world)
        })
    }
}

/// Draws a placement whose object is Meta-World's decoy.
fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    draw_apart(MIN_DISTANCE, || Placement {
        object: draw_at(DECOY_Z, [META_WORLD_X, DECOY_Y], rng),
        goal: draw_in([META_WORLD_X, META_WORLD_GOAL_Y, META_WORLD_GOAL_Z], rng),
    })
}

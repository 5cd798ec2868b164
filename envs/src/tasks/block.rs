//! Push and Pick Place: take a loose block, and slide or carry it to a mark.

use std::ops::Range;

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::caging::{caging_reward, is_held, is_lifted, sided_caging_reward, take_and_carry};
use super::{CANONICAL_X, META_WORLD_X, draw_apart, draw_at, draw_in, spec};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of sliding a block over the table to a marked goal.
#[derive(Clone, Copy, Debug)]
pub struct Push;

/// Task of carrying a block to a marked goal in the air, which the vector observation contains.
#[derive(Clone, Copy, Debug)]
pub struct PickPlace;

/// Range of the block's start along x (metres).
const BLOCK_X: Range<f64> = 0.08..0.16;
/// Range of the block's start along y (metres).
const BLOCK_Y: Range<f64> = -0.06..0.02;
/// Range of the goal along y (metres).
const GOAL_Y: Range<f64> = 0.14..0.20;
/// Range of the height of a goal in the air (metres).
const GOAL_Z: Range<f64> = 0.08..0.20;
/// Half the height of the block (metres).
const BLOCK_Z: f64 = 0.015;
/// Half the height of Meta-World's block (metres).
const META_WORLD_BLOCK_Z: f64 = 0.02;
/// Range of the start of Meta-World's block along y (metres).
const META_WORLD_BLOCK_Y: Range<f64> = 0.0..0.1;
/// Range of Meta-World's goal along y (metres).
const META_WORLD_GOAL_Y: Range<f64> = 0.2..0.3;
/// Range of the height of Meta-World's goal in the air (metres).
const META_WORLD_GOAL_Z: Range<f64> = 0.05..0.3;
/// Height at which Meta-World's block has come to rest (metres).
const META_WORLD_REST: f64 = 0.01987216319940059;
/// Smallest distance of Meta-World's block from its goal in the plane (metres).
const MIN_DISTANCE: f64 = 0.15;

/// Distance of the block from its goal at full reward, and for Push at success (metres).
const BOUND: f64 = 0.05;
/// Distance of the block from its goal at success of Pick Place (metres).
const PLACED: f64 = 0.07;
/// Distance of the fingertips from a held block (metres).
const HELD: f64 = 0.02;
/// Distances of the pads from a held block along y (metres).
const PADS: [f64; 2] = [0.015, 0.05];

/// Height of the expert's hand above a block that it takes (metres).
const GRIP: f64 = 0.04;
/// Height of the expert's hand while it slides the block (metres): its fingers clear the table.
const PUSHING_Z: f64 = 0.055;

impl Task for Push {
    fn name(&self) -> &str {
        "push"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = draw_block(rng);
        Placement { object, goal: draw_at(BLOCK_Z, [CANONICAL_X, GOAL_Y], rng) }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let caged = caging_reward(start, now, PADS, finger);
        let [goal_distance, placed] = placing(start, now);
        let held = is_held(now, HELD);
        let success = goal_distance <= BOUND;
        StepReward {
            approach_reward: caged,
            in_place_reward: placed,
            goal_distance,
            // a block at its goal need not be held
            reward: if goal_distance < BOUND {
                10.0
            } else if held {
                1.0 + 4.0 * caged + 5.0 * placed
            } else {
                2.0 * caged
            },
            success,
        }
    }

    /// Takes the block and slides it to the mark.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        // low, so that a block between the fingers slides and is not lifted
        let aim = DVec3::new(now.object.x, now.object.y, PUSHING_Z);
        let to = DVec3::new(placement.goal.x, placement.goal.y, PUSHING_Z);
        let moved = (now.object - placement.object).truncate().length();
        take_and_carry(now, aim, to, moved)
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        parts(part!("push.xml").1)
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("push", |rng| {
            let Placement { object, goal } = place_meta_world(rng);
            Placement { object: on_table(object), goal: on_table(goal) }
        }))
    }
}

impl Task for PickPlace {
    fn name(&self) -> &str {
        "pick-place"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = draw_block(rng);
        Placement { object, goal: draw_in([CANONICAL_X, GOAL_Y, GOAL_Z], rng) }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let caged = sided_caging_reward(start, now, PADS, finger);
        let [goal_distance, placed] = placing(start, now);
        let held = is_held(now, HELD) && is_lifted(start, now);
        let carried = if held { 1.0 + 5.0 * placed } else { 0.0 };
        StepReward {
            approach_reward: caged,
            in_place_reward: placed,
            goal_distance,
            reward: if goal_distance < BOUND {
                10.0
            } else {
                hamacher_product(caged, placed) + carried
            },
            success: goal_distance <= PLACED,
        }
    }

    /// Takes the block and carries it to the mark.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let aim = now.object + GRIP * DVec3::Z;
        // the block may sit askew in the grip, so the hand stays as far from it as it is
        let to = placement.goal + (now.hand - now.object);
        take_and_carry(now, aim, to, now.object.z - placement.object.z)
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts { goal_observable: true, ..parts(part!("pick_place.xml").1) }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("pick-place", place_meta_world))
    }
}

fn parts(mjcf: &'static str) -> TaskSceneParts<'static> {
    TaskSceneParts {
        mjcf: Some(mjcf),
        object_body: Some("block"),
        loose_joint: Some("loose"),
        ..TaskSceneParts::default()
    }
}

fn draw_block(rng: &mut ChaCha8Rng) -> DVec3 {
    draw_at(BLOCK_Z, [BLOCK_X, BLOCK_Y], rng)
}

/// Returns the distance of the block from its goal (metres), and its reward in `[0, 1]`.
fn placing(start: &EpisodeStart, now: &TaskState) -> [f64; 2] {
    let Placement { object, goal } = start.placement;
    let distance = now.object.distance(goal);
    [distance, long_tail_reward(distance, BOUND, object.distance(goal))]
}

fn on_table(point: DVec3) -> DVec3 {
    DVec3::new(point.x, point.y, META_WORLD_REST)
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    draw_apart(MIN_DISTANCE, || Placement {
        object: draw_at(META_WORLD_BLOCK_Z, [META_WORLD_X, META_WORLD_BLOCK_Y], rng),
        goal: draw_in([META_WORLD_X, META_WORLD_GOAL_Y, META_WORLD_GOAL_Z], rng),
    })
}

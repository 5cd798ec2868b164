//! Push and Pick Place: take a loose block, and slide or carry it to a mark.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::caging::{caging_reward, sided_caging_reward, take_and_carry};
use super::{CANONICAL_X, META_WORLD_X, spec, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of sliding a block over the table to a mark.
#[derive(Clone, Copy, Debug)]
pub struct Push;

/// Task of carrying a block to a mark in the air, which the vector observation contains.
#[derive(Clone, Copy, Debug)]
pub struct PickPlace;

/// Ranges of the block's start and of its goal (metres).
const BLOCK_X: std::ops::Range<f64> = 0.08..0.16;
const BLOCK_Y: std::ops::Range<f64> = -0.06..0.02;
const GOAL_Y: std::ops::Range<f64> = 0.14..0.20;
const GOAL_Z: std::ops::Range<f64> = 0.08..0.20;
/// Half the height of the block, and of Meta-World's (metres).
const BLOCK_Z: f64 = 0.015;
const META_WORLD_BLOCK_Z: f64 = 0.02;
const META_WORLD_BLOCK_Y: std::ops::Range<f64> = 0.0..0.1;
const META_WORLD_GOAL_Y: std::ops::Range<f64> = 0.2..0.3;
const META_WORLD_GOAL_Z: std::ops::Range<f64> = 0.05..0.3;
/// Height at which Meta-World's block has come to rest (metres).
const META_WORLD_REST: f64 = 0.01987216319940059;
/// Smallest distance of Meta-World's block from its goal in the plane (metres).
const MIN_DISTANCE: f64 = 0.15;

/// Distances of the block from its goal at full reward (and for Push at success) and at success of
/// Pick Place, and of the fingertips from a held block (metres).
const BOUND: f64 = 0.05;
const PLACED: f64 = 0.07;
const HELD: f64 = 0.02;
/// Distances of the pads from a held block along y (metres).
const PADS: [f64; 2] = [0.015, 0.05];
/// Height by which a block is lifted (metres).
const LIFTED: f64 = 0.01;

/// Heights of the expert's hand above the block, and of a hand that pushes it (metres).
const GRIP: f64 = 0.04;
const PUSHING_Z: f64 = 0.055;

impl Task for Push {
    fn name(&self) -> &str {
        "push"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = draw_block(rng);
        let goal = DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, GOAL_Y), BLOCK_Z);
        Placement { object, goal }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let caged = caging_reward(start, now, PADS, finger);
        let [goal_distance, placed] = placing(start, now);
        let held = now.object.distance(now.tcp) < HELD && now.aperture > 0.0;
        let success = goal_distance <= BOUND;
        StepReward {
            approach_reward: caged,
            in_place_reward: placed,
            goal_distance,
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
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = DVec3::new(now.object.x, now.object.y, PUSHING_Z);
        let to = DVec3::new(placement.goal.x, placement.goal.y, PUSHING_Z);
        take_and_carry(now, aim, to)
    }

    fn parts(&self) -> TaskParts<'_> {
        parts(part!("push.xml").1)
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
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

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = draw_block(rng);
        let (x, y) = (uniform(rng, CANONICAL_X), uniform(rng, GOAL_Y));
        Placement { object, goal: DVec3::new(x, y, uniform(rng, GOAL_Z)) }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let caged = sided_caging_reward(start, now, PADS, finger);
        let [goal_distance, placed] = placing(start, now);
        let held = now.object.distance(now.tcp) < HELD
            && now.aperture > 0.0
            && now.object.z - LIFTED > start.placement.object.z;
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
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + GRIP * DVec3::Z;
        let to = placement.goal + (now.hand - now.object);
        take_and_carry(now, aim, to)
    }

    fn parts(&self) -> TaskParts<'_> {
        TaskParts { goal_observable: true, ..parts(part!("pick_place.xml").1) }
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(spec("pick-place", place_meta_world))
    }
}

fn parts(mjcf: &'static str) -> TaskParts<'static> {
    TaskParts {
        mjcf: Some(mjcf),
        object_body: Some("block"),
        loose_joint: Some("loose"),
        ..TaskParts::default()
    }
}

fn draw_block(rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::new(uniform(rng, BLOCK_X), uniform(rng, BLOCK_Y), BLOCK_Z)
}

/// Returns the distance of the block from its goal (metres), and its reward in `[0, 1]`.
fn placing(start: &EpisodeStart, now: &Measurement) -> [f64; 2] {
    let Placement { object, goal } = start.placement;
    let distance = now.object.distance(goal);
    [distance, long_tail_reward(distance, BOUND, object.distance(goal))]
}

fn on_table(point: DVec3) -> DVec3 {
    DVec3::new(point.x, point.y, META_WORLD_REST)
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    loop {
        let object = DVec3::new(
            uniform(rng, META_WORLD_X),
            uniform(rng, META_WORLD_BLOCK_Y),
            META_WORLD_BLOCK_Z,
        );
        let goal = DVec3::new(
            uniform(rng, META_WORLD_X),
            uniform(rng, META_WORLD_GOAL_Y),
            uniform(rng, META_WORLD_GOAL_Z),
        );
        if (goal - object).truncate().length() >= MIN_DISTANCE {
            return Placement { object, goal };
        }
    }
}

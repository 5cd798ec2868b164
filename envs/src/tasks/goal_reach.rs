//! Goal Reach: move the fingertips to a point that the vector observation contains and pictures do
//! not show.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_X, spec, uniform};
use crate::mjcf::part;
use crate::reward::long_tail_reward;
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of moving the fingertips to a goal; its scene is the bare table.
#[derive(Clone, Copy, Debug)]
pub struct GoalReach;

/// Distance of the fingertips from the goal at success (metres).
const RADIUS: f64 = 0.05;
const GOAL_Y: std::ops::Range<f64> = 0.08..0.18;
const GOAL_Z: std::ops::Range<f64> = 0.08..0.25;

const META_WORLD_GOAL_Y: std::ops::Range<f64> = 0.2..0.3;
const META_WORLD_GOAL_Z: std::ops::Range<f64> = 0.05..0.3;
/// Smallest distance of Meta-World's loose cylinder from the goal (metres).
const MIN_DISTANCE: f64 = 0.15;
/// Height of the loose cylinder (metres).
const DECOY_Z: f64 = 0.02;
/// Range of the loose cylinder along y (metres).
const DECOY_Y: std::ops::Range<f64> = 0.0..0.1;

impl Task for GoalReach {
    fn name(&self) -> &str {
        "goal-reach"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let goal =
            DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, GOAL_Y), uniform(rng, GOAL_Z));
        Placement { object: goal, goal }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let goal = start.placement.goal;
        let distance = now.tcp.distance(goal);
        let margin = start.hand_target.distance(goal);
        let in_place_reward = long_tail_reward(distance, RADIUS, margin);
        StepReward {
            approach_reward: 1.0,
            in_place_reward,
            goal_distance: distance,
            reward: 10.0 * in_place_reward,
            success: distance <= RADIUS,
        }
    }

    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        ExpertCommand { hand: placement.goal + (now.hand - now.tcp), finger: 0.0 }
    }

    fn parts(&self) -> TaskParts<'_> {
        TaskParts { goal_observable: true, ..TaskParts::default() }
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(MetaWorldSpec {
            extra_mjcf: Some(part!("decoy.xml" in "metaworld").1),
            ..spec("reach", place_meta_world)
        })
    }
}

/// Draws a placement whose object is Meta-World's decoy, at least 0.15 m from the goal in the
/// plane.
fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    loop {
        let object = DVec3::new(uniform(rng, META_WORLD_X), uniform(rng, DECOY_Y), DECOY_Z);
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

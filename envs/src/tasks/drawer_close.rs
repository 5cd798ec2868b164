//! Drawer Close: push an open drawer shut along +y.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_X, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of pushing a drawer shut.
#[derive(Clone, Copy, Debug)]
pub struct DrawerClose;

const CASE_Y: f64 = 0.3;
/// Joint position of the open drawer (metres); 0 is closed.
const OPEN: f64 = -0.15;
/// Distances to the target at full reward and at success (metres).
const BOUND: f64 = 0.05;
const SUCCESS: f64 = 0.065;
/// Distance of the fingertips from the handle that counts as touching (metres).
const TOUCHING: f64 = 0.005;
/// Offset from the drawer body's origin to the point above its handle (metres).
const HANDLE: DVec3 = DVec3::new(0.0, -0.16, 0.05);
/// Offset from the case's origin to the target of that point (metres). It is 0.05 m lower than the
/// point can be, so the distance is never zero.
const CLOSED: DVec3 = DVec3::new(0.0, -0.16, 0.09);

impl Task for DrawerClose {
    fn name(&self) -> &str {
        "drawer-close"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), CASE_Y, 0.0);
        Placement { object, goal: object + CLOSED }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let EpisodeStart { placement, measurement, .. } = start;
        let goal_distance = now.object.distance(placement.goal);
        let at_start = measurement.object.distance(placement.goal);
        let shut = long_tail_reward(goal_distance, BOUND, (at_start - BOUND).abs());
        let margin = (measurement.object.distance(measurement.tcp) - TOUCHING).abs();
        let reached = gaussian_reward(now.object.distance(now.tcp), TOUCHING, margin);
        let success = goal_distance <= SUCCESS;
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
    fn expert(&self, _: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, 0.0, -0.02);
        let near_side = aim + DVec3::new(0.0, -0.075, 0.0);
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

    fn parts(&self) -> TaskParts<'_> {
        TaskParts {
            start_joints: &[("slide", OPEN)],
            ..scene(part!("drawer.xml").1, "drawer", HANDLE)
        }
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(spec("drawer-close", place_meta_world))
    }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    let object = DVec3::new(uniform(rng, META_WORLD_X), CASE_Y, 0.0);
    Placement { object, goal: object + CLOSED }
}

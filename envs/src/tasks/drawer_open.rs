//! Drawer Open: pull a shut drawer open along -y by its handle.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::approach::{come_down, is_down_at};
use super::{CANONICAL_X, META_WORLD_X, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::long_tail_reward;
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of pulling a drawer open.
#[derive(Clone, Copy, Debug)]
pub struct DrawerOpen;

/// Position of the case along y (metres); its back is clear of the wall.
const CASE_Y: f64 = 0.26;
const META_WORLD_CASE_Y: f64 = 0.3;
/// Offset from the drawer body's origin to its handle (metres).
const HANDLE: DVec3 = DVec3::new(0.0, -0.16, 0.0);
/// Offset from the case's origin to the handle of a shut drawer (metres).
const SHUT: DVec3 = DVec3::new(0.0, -0.16, 0.09);
/// Way of the handle to its target (metres).
const WAY: f64 = 0.17;
/// Way of the handle in Meta-World (metres): to 4 cm beyond the stop, against which the hand must
/// pull.
const META_WORLD_WAY: f64 = 0.2;
/// Distances of the handle from its target at full reward and at success (metres).
const BOUND: f64 = 0.02;
const SUCCESS: f64 = 0.03;
/// Weights of the hand's distance from the handle along the axes: the hand may be high, but not
/// beside it.
const WEIGHTS: DVec3 = DVec3::new(3.0, 3.0, 1.0);
/// Weighted distance of the hand from the handle at full reward (metres).
const CAGED: f64 = 0.01;

impl Task for DrawerOpen {
    fn name(&self) -> &str {
        "drawer-open"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(DVec3::new(uniform(rng, CANONICAL_X), CASE_Y, 0.0), WAY)
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let EpisodeStart { placement, measurement, .. } = start;
        let goal_distance = now.object.distance(placement.goal);
        let shut = placement.object + SHUT;
        let opened = long_tail_reward(goal_distance, BOUND, placement.goal.distance(shut));
        let off = ((now.object - now.hand) * WEIGHTS).length();
        // as in Meta-World, the margin begins at the fingertips, not at the hand
        let margin = ((shut - measurement.tcp) * WEIGHTS).length();
        let caged = long_tail_reward(off, CAGED, margin);
        StepReward {
            approach_reward: caged,
            in_place_reward: opened,
            goal_distance,
            reward: 5.0 * (caged + opened),
            success: goal_distance <= SUCCESS,
        }
    }

    /// Comes down around the bar of the handle with open fingers, then pulls.
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, 0.008, 0.02);
        let hand = if is_down_at(now.hand, aim, 0.045) {
            let y = (aim.y - 0.08).max(placement.goal.y);
            DVec3::new(aim.x, y, aim.z)
        } else {
            come_down(now.hand, aim, 0.09).unwrap_or(aim)
        };
        ExpertCommand { hand, finger: -1.0 }
    }

    fn parts(&self) -> TaskParts<'_> {
        scene(part!("drawer.xml").1, "drawer", HANDLE)
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(spec("drawer-open", |rng| {
            let case = DVec3::new(uniform(rng, META_WORLD_X), META_WORLD_CASE_Y, 0.0);
            place(case, META_WORLD_WAY)
        }))
    }
}

fn place(case: DVec3, way: f64) -> Placement {
    Placement { object: case, goal: case + SHUT - way * DVec3::Y }
}

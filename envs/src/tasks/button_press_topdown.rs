//! Button Press Topdown: push a button that faces up into its box.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_HAND_BACK, META_WORLD_X, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of pressing a button from above.
#[derive(Clone, Copy, Debug)]
pub struct ButtonPressTopdown;

const BOX_Y: std::ops::Range<f64> = 0.16..0.24;
/// Height of the box's centre (metres): half of it is in the table, so that the hand comes over the
/// button.
const BOX_Z: f64 = 0.0;
const META_WORLD_BOX_Y: std::ops::Range<f64> = 0.2..0.3;
const META_WORLD_BOX_Z: f64 = 0.115;
/// Offset from the button body's origin to the middle of its cap (metres).
const CAP: DVec3 = DVec3::new(0.0, 0.0, 0.193);
/// Offset from the box's centre to the cap's position when fully pressed (metres).
const HOLE: DVec3 = DVec3::new(0.0, 0.0, 0.1);
/// [`HOLE`] in Meta-World, whose box is turned by 1.57 rather than a right angle.
const META_WORLD_HOLE: DVec3 = DVec3::new(0.0, -7.963267107332634e-5, 0.09999996829318347);
/// Travel from rest to the fully pressed position (metres), the reward's margin: 0.0935 turned by
/// 1.57.
const TRAVEL: f64 = 0.09349997035412654;
/// Remaining travel at success and at full reward (metres).
const SUCCESS: f64 = 0.024;
const PRESSED: f64 = 0.005;
/// Distances of the fingertips from the cap at full reward, and within which a press counts
/// (metres).
const TOUCHING: f64 = 0.01;
const NEAR: f64 = 0.03;

impl Task for ButtonPressTopdown {
    fn name(&self) -> &str {
        "button-press-topdown"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, BOX_Y), BOX_Z);
        Placement { object, goal: object + HOLE }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let goal_distance = (start.placement.goal.z - now.object.z).abs();
        let distance = now.object.distance(now.tcp);
        // as in Meta-World, the margin is the cap's present distance from the fingertips' start
        let margin = now.object.distance(start.measurement.tcp);
        let near = long_tail_reward(distance, TOUCHING, margin);
        let pressed = long_tail_reward(goal_distance, PRESSED, TRAVEL);
        let touching = if distance <= NEAR { 1.0 } else { 0.0 };
        StepReward {
            approach_reward: near,
            in_place_reward: pressed,
            goal_distance,
            reward: 5.0 * hamacher_product(1.0 - now.aperture, near) + 5.0 * pressed * touching,
            success: goal_distance <= SUCCESS,
        }
    }

    /// Goes over the cap with closed fingers, then straight down.
    fn expert(&self, _: &Placement, now: &Measurement) -> ExpertCommand {
        // commands move the hand, so the aim is offset by the distance of the fingertips from it
        let aim = now.object + (now.hand - now.tcp);
        let hand = if (now.hand - aim).truncate().length() > 0.02 {
            DVec3::new(aim.x, aim.y, now.hand.z.max(aim.z + 0.05))
        } else {
            aim - 0.1 * DVec3::Z
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskParts<'_> {
        scene(part!("button_press_topdown.xml").1, "button", CAP)
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(MetaWorldSpec {
            hand_target: META_WORLD_HAND_BACK,
            ..spec("button-press-topdown", place_meta_world)
        })
    }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    let (x, y) = (uniform(rng, META_WORLD_X), uniform(rng, META_WORLD_BOX_Y));
    let object = DVec3::new(x, y, META_WORLD_BOX_Z);
    Placement { object, goal: object + META_WORLD_HOLE }
}

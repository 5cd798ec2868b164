//! Button Press: push a button that faces -y into its box.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, META_WORLD_HAND_BACK, META_WORLD_X, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of pressing a button into its box.
#[derive(Clone, Copy, Debug)]
pub struct ButtonPress;

/// Range of the box's centre along y (metres): nearer than Meta-World's 0.25..0.30, so that the arm
/// reaches past the pressed button.
const BOX_Y: std::ops::Range<f64> = 0.22..0.27;
const META_WORLD_BOX_Y: std::ops::Range<f64> = 0.25..0.30;
const BOX_Z: f64 = 0.115;
/// Offset from the button body's origin to the middle of its cap (metres).
const CAP: DVec3 = DVec3::new(0.0, -0.193, 0.0);
/// Offset from the box's centre to the cap's position when fully pressed (metres).
const HOLE: DVec3 = DVec3::new(0.0, -0.1, 0.0);
/// Travel from rest to the fully pressed position (metres), the reward's margin.
const TRAVEL: f64 = 0.0935;
/// Remaining travel at success and at full reward (metres).
const SUCCESS: f64 = 0.02;
const PRESSED: f64 = 0.005;
/// Distance of the fingertips from the cap that counts as touching (metres).
const NEAR: f64 = 0.05;

impl Task for ButtonPress {
    fn name(&self) -> &str {
        "button-press"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, BOX_Y), BOX_Z);
        Placement { object, goal: object + HOLE }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let goal_distance = (start.placement.goal.y - now.object.y).abs();
        let distance = now.object.distance(now.tcp);
        // as in Meta-World, the margin is the cap's present distance from the fingertips' start
        let near = long_tail_reward(distance, NEAR, now.object.distance(start.measurement.tcp));
        let pressed = long_tail_reward(goal_distance, PRESSED, TRAVEL);
        let touching = if distance <= NEAR { 1.0 } else { 0.0 };
        StepReward {
            approach_reward: near,
            in_place_reward: pressed,
            goal_distance,
            reward: 2.0 * hamacher_product(now.aperture, near) + 8.0 * pressed * touching,
            success: goal_distance <= SUCCESS,
        }
    }

    /// Goes in front of the cap, well clear of it, then straight through.
    fn expert(&self, _: &Placement, now: &Measurement) -> ExpertCommand {
        // commands move the hand, so the aim is offset by the distance of the fingertips from it
        let aim = now.object + (now.hand - now.tcp);
        let off_axis = (now.hand.x - aim.x).abs().max((now.hand.z - aim.z).abs());
        let hand = if off_axis > 0.02 {
            DVec3::new(aim.x, now.hand.y.min(aim.y - 0.1), aim.z)
        } else {
            aim + DVec3::new(0.0, 0.1, 0.0)
        };
        ExpertCommand { hand, finger: 0.0 }
    }

    fn parts(&self) -> TaskParts<'_> {
        scene(part!("button_press.xml").1, "button", CAP)
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(MetaWorldSpec {
            hand_target: META_WORLD_HAND_BACK,
            ..spec("button-press", place_meta_world)
        })
    }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    let object = DVec3::new(uniform(rng, META_WORLD_X), uniform(rng, META_WORLD_BOX_Y), BOX_Z);
    Placement { object, goal: object + HOLE }
}

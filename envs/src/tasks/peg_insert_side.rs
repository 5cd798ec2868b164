//! Peg Insert Side: take a peg and put its head into the channel of a box on the left.

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::caging::{caging_reward, take_and_carry};
use super::{spec, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of inserting a peg into a box from the side.
#[derive(Clone, Copy, Debug)]
pub struct PegInsertSide;

/// Ranges of the peg and of the box (metres).
const PEG_X: std::ops::Range<f64> = 0.10..0.16;
const PEG_Y: std::ops::Range<f64> = 0.02..0.12;
const PEG_Z: f64 = 0.02;
const BOX_X: std::ops::Range<f64> = -0.24..-0.20;
const BOX_Y: std::ops::Range<f64> = 0.02..0.14;
const META_WORLD_PEG_X: std::ops::Range<f64> = 0.0..0.2;
const META_WORLD_PEG_Y: std::ops::Range<f64> = -0.1..0.1;
const META_WORLD_BOX_X: std::ops::Range<f64> = -0.35..-0.25;
const META_WORLD_BOX_Y: std::ops::Range<f64> = -0.2..0.1;
const META_WORLD_BOX_Z: std::ops::Range<f64> = -0.001..0.001;
/// Smallest distance of Meta-World's peg from its box in the plane (metres).
const MIN_DISTANCE: f64 = 0.1;

/// Offset from the box to the target of the peg's head (metres).
const HOLE: DVec3 = DVec3::new(0.03, 0.0, 0.13);
/// Weights of the head's distance from its target along the axes.
const WEIGHTS: DVec3 = DVec3::new(1.0, 2.0, 2.0);
/// Weighted distance of the head from its target at full reward and success (metres).
const SUCCESS: f64 = 0.07;
/// Position of the head of a peg that rests at the centre (metres). As in Meta-World, the reward's
/// margin begins there, wherever the peg starts.
const RESTING_HEAD: DVec3 = DVec3::new(-0.09999999809830853, 0.0, 0.01478468493633014);
/// Corners of the spaces before the box, below and above its channel, with no reward and with full
/// reward (metres; from the box, x to its right side).
const BELOW: [DVec3; 2] = [DVec3::new(0.1, -0.11, 0.01), DVec3::new(-0.1, -0.15, 0.096)];
const ABOVE: [DVec3; 2] = [DVec3::new(0.1, -0.11, 0.16), DVec3::new(-0.1, -0.17, 0.19)];
/// Angle of Meta-World's box (radians), rather than a right one.
const BOX_ANGLE: f64 = 1.57;
/// Distances of the pads from a held peg along y, and of the fingertips from it (metres).
const PADS: [f64; 2] = [0.0075, 0.03];
const HELD: f64 = 0.08;
/// Height by which a peg is lifted (metres).
const LIFTED: f64 = 0.01;

/// Height of the expert's hand above the grip (metres).
const GRIP: f64 = 0.03;
/// Distance of the head from the box before it is at the channel's height (metres), how far off it
/// may be, and the length of a step of insertion.
const BEFORE_BOX: f64 = 0.16;
const ALIGNED: f64 = 0.012;
const STEP: f64 = 0.08;

impl Task for PegInsertSide {
    fn name(&self) -> &str {
        "peg-insert-side"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, PEG_X), uniform(rng, PEG_Y), PEG_Z);
        Placement { object, goal: DVec3::new(uniform(rng, BOX_X), uniform(rng, BOX_Y), 0.0) }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let Placement { object, goal } = start.placement;
        let off = |head: DVec3| ((head - (goal + HOLE)) * WEIGHTS).length();
        let goal_distance = off(now.tip);
        let inserted = long_tail_reward(goal_distance, SUCCESS, off(RESTING_HEAD));
        let clear = hamacher_product(
            space_reward(goal, now.tip, ABOVE),
            space_reward(goal, now.tip, BELOW),
        );
        let placed = hamacher_product(inserted, clear);
        let held = now.object.distance(now.tcp) < HELD
            && now.aperture > 0.0
            && now.object.z - LIFTED > object.z;
        let caged = if held { 1.0 } else { caging_reward(start, now, PADS, finger) };
        let carried = if held { 1.0 + 5.0 * placed } else { 0.0 };
        let success = goal_distance <= SUCCESS;
        StepReward {
            approach_reward: caged,
            in_place_reward: placed,
            goal_distance,
            reward: if success { 10.0 } else { hamacher_product(caged, placed) + carried },
            success,
        }
    }

    /// Takes the peg, lifts it in front of the channel and pushes it in.
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let off = placement.goal + HOLE - now.tip;
        let x = if off.y.hypot(off.z) > ALIGNED {
            (placement.goal.x + BEFORE_BOX - now.tip.x).max(0.0)
        } else {
            off.x.max(-STEP)
        };
        let to = now.hand + DVec3::new(x, off.y, off.z);
        take_and_carry(now, now.object + GRIP * DVec3::Z, to)
    }

    fn parts(&self) -> TaskParts<'_> {
        TaskParts {
            mjcf: Some(part!("peg_insert_side.xml").1),
            object_body: Some("grasp"),
            tip_body: Some("peg_head"),
            loose_joint: Some("loose"),
            handed: true,
            ..TaskParts::default()
        }
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(spec("peg-insert-side", place_meta_world))
    }
}

/// Returns 1 outside a space before the box, and inside it the share of the way to its `full`
/// corner along each axis, multiplied.
fn space_reward(placed_box: DVec3, head: DVec3, corners: [DVec3; 2]) -> f64 {
    let [none, full] = corners.map(|corner| {
        let turned = DVec2::from_angle(BOX_ANGLE).rotate(corner.truncate());
        placed_box + turned.extend(corner.z)
    });
    let share = (head - none) / (full - none);
    let inside = share.min_element() >= 0.0 && share.max_element() <= 1.0;
    if inside { share.element_product() } else { 1.0 }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    loop {
        let object =
            DVec3::new(uniform(rng, META_WORLD_PEG_X), uniform(rng, META_WORLD_PEG_Y), PEG_Z);
        let goal = DVec3::new(
            uniform(rng, META_WORLD_BOX_X),
            uniform(rng, META_WORLD_BOX_Y),
            uniform(rng, META_WORLD_BOX_Z),
        );
        if (goal - object).truncate().length() >= MIN_DISTANCE {
            return Placement { object, goal };
        }
    }
}

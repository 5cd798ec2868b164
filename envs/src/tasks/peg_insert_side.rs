//! Peg Insert Side: take a peg and put its head into the channel of a box on the left.

use std::ops::Range;

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::caging::{caging_reward, is_held, is_lifted, take_and_carry};
use super::{draw_apart, draw_at, draw_in, spec};
use crate::mjcf::part;
use crate::reward::{hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of inserting a peg into a box from the side.
#[derive(Clone, Copy, Debug)]
pub struct PegInsertSide;

/// Range of the peg along x (metres).
const PEG_X: Range<f64> = 0.10..0.16;
/// Range of the peg along y (metres).
const PEG_Y: Range<f64> = 0.02..0.12;
/// Height of the peg's centre (metres).
const PEG_Z: f64 = 0.02;
/// Range of the box along x (metres): at the far end of the arm's symmetric reach.
const BOX_X: Range<f64> = -0.24..-0.20;
/// Range of the box along y (metres).
const BOX_Y: Range<f64> = 0.02..0.14;
/// Range of Meta-World's peg along x (metres).
const META_WORLD_PEG_X: Range<f64> = 0.0..0.2;
/// Range of Meta-World's peg along y (metres).
const META_WORLD_PEG_Y: Range<f64> = -0.1..0.1;
/// Range of Meta-World's box along x (metres).
const META_WORLD_BOX_X: Range<f64> = -0.35..-0.25;
/// Range of Meta-World's box along y (metres).
const META_WORLD_BOX_Y: Range<f64> = -0.2..0.1;
/// Range of the height of Meta-World's box (metres).
const META_WORLD_BOX_Z: Range<f64> = -0.001..0.001;
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
/// Corners of the space before the box below its channel, with no reward and with full reward
/// (metres; from the box, x to its right side).
const BELOW: [DVec3; 2] = [DVec3::new(0.1, -0.11, 0.01), DVec3::new(-0.1, -0.15, 0.096)];
/// [`BELOW`] for the space above the channel.
const ABOVE: [DVec3; 2] = [DVec3::new(0.1, -0.11, 0.16), DVec3::new(-0.1, -0.17, 0.19)];
/// Angle of Meta-World's box (radians), rather than a right one.
const BOX_ANGLE: f64 = 1.57;
/// Distances of the pads from a held peg along y (metres).
const PADS: [f64; 2] = [0.0075, 0.03];
/// Distance of the fingertips from a held peg (metres).
const HELD: f64 = 0.08;

/// Height of the grip above the peg's centre (metres).
const GRASP_ABOVE: f64 = 0.01;
/// Height of the expert's hand above the grip (metres).
const GRIP: f64 = 0.03;
/// Distance of the head from the box while it is not in line with the channel (metres).
const BEFORE_BOX: f64 = 0.16;
/// Distance of the head from the channel's line from which it is pushed in (metres): less than its
/// play there.
const ALIGNED: f64 = 0.012;
/// Length of a step of insertion (metres).
const STEP: f64 = 0.08;

impl Task for PegInsertSide {
    fn name(&self) -> &str {
        "peg-insert-side"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = draw_at(PEG_Z, [PEG_X, PEG_Y], rng);
        Placement { object, goal: draw_at(0.0, [BOX_X, BOX_Y], rng) }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let goal = start.placement.goal;
        let off = |head: DVec3| ((head - (goal + HOLE)) * WEIGHTS).length();
        let goal_distance = off(now.tip);
        // the margin does not depend on where the peg starts
        let inserted = long_tail_reward(goal_distance, SUCCESS, off(RESTING_HEAD));
        // 1 unless the head is beside the channel, where going on would jam it
        let clear = hamacher_product(
            space_reward(goal, now.tip, ABOVE),
            space_reward(goal, now.tip, BELOW),
        );
        let placed = hamacher_product(inserted, clear);
        let held = is_held(now, HELD) && is_lifted(start, now);
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
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let off = placement.goal + HOLE - now.tip;
        // in line first: a peg that enters askew jams at the rim
        let x = if off.y.hypot(off.z) > ALIGNED {
            (placement.goal.x + BEFORE_BOX - now.tip.x).max(0.0)
        } else {
            off.x.max(-STEP)
        };
        let to = now.hand + DVec3::new(x, off.y, off.z);
        let lifted = now.object.z - GRASP_ABOVE - placement.object.z;
        take_and_carry(now, now.object + GRIP * DVec3::Z, to, lifted)
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            mjcf: Some(part!("peg_insert_side.xml").1),
            object_body: Some("grasp"),
            tip_body: Some("peg_head"),
            loose_joint: Some("loose"),
            handed: true,
            ..TaskSceneParts::default()
        }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("peg-insert-side", place_meta_world))
    }
}

/// Returns 1 outside a space before the box, and inside it the share of the way to its `full`
/// corner along each axis, multiplied.
fn space_reward(placed_box: DVec3, head: DVec3, corners: [DVec3; 2]) -> f64 {
    let [none, full] = corners.map(|corner| {
        // the box is turned, and so are the corners of its spaces
        let turned = DVec2::from_angle(BOX_ANGLE).rotate(corner.truncate());
        placed_box + turned.extend(corner.z)
    });
    let share = (head - none) / (full - none);
    // in the box of the two corners, the product of three shares falls to 0 at one face
    let inside = share.min_element() >= 0.0 && share.max_element() <= 1.0;
    if inside { share.element_product() } else { 1.0 }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    draw_apart(MIN_DISTANCE, || Placement {
        object: draw_at(PEG_Z, [META_WORLD_PEG_X, META_WORLD_PEG_Y], rng),
        goal: draw_in([META_WORLD_BOX_X, META_WORLD_BOX_Y, META_WORLD_BOX_Z], rng),
    })
}

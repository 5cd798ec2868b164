//! Faucet Close: turn the handle of a faucet to the left.

use std::ops::Range;

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::caging::{come_down, is_down_at};
use super::{CANONICAL_X, META_WORLD_HAND_BACK, META_WORLD_X, angle_to, draw_at, scene, spec};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of turning a faucet shut.
#[derive(Clone, Copy, Debug)]
pub struct FaucetClose;

/// Range of the faucet along y (metres).
const FAUCET_Y: Range<f64> = 0.16..0.22;
/// Range of Meta-World's faucet along y (metres).
const META_WORLD_FAUCET_Y: Range<f64> = 0.2..0.25;
/// Lowest target of Meta-World's hand (metres): its table does not stop it.
const FAUCET_LOWEST: f64 = -0.15;
/// Offset from the tip of the handle to the point that the reward reads (metres).
const TIP: DVec3 = DVec3::new(0.0, 0.0, -0.01);
/// Position of that point from the axis at the start (metres). The joint is then at 0 and half
/// open; 1.57 is open, and -1.57 is shut.
const TIP_AT_START: DVec2 = DVec2::new(0.015, -0.175);
/// Offset from the faucet to the target of that point (metres).
const SHUT: DVec3 = DVec3::new(-0.175, 0.0, 0.125);
/// Distance of the point from its target at success (metres).
const SUCCESS: f64 = 0.07;
/// Distance of the fingertips from the point at full reward (metres).
const TOUCHING: f64 = 0.01;

/// Place of the expert's hand on the right of the handle, from the axis of a faucet at joint 0
/// (metres).
const BESIDE_HANDLE: DVec2 = DVec2::new(0.045, -0.165);
/// Place of the expert's hand while it pushes, from the axis of a faucet at joint 0 (metres).
const AGAINST_HANDLE: DVec2 = DVec2::new(0.045, -0.15);
/// Height of the expert's hand above the foot of the faucet (metres).
const HAND_ABOVE_BASE: f64 = 0.145;
/// Height of the hand's way there above that (metres).
const CLEARANCE: f64 = 0.08;
/// Angle by which the expert is ahead of the handle (radians).
const LEAD: f64 = 0.4;
/// Angle beyond which the expert turns no further (radians): the joint ends at -1.57.
const TURNED: f64 = -1.5;

impl Task for FaucetClose {
    fn name(&self) -> &str {
        "faucet-close"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_at(0.0, [CANONICAL_X, FAUCET_Y], rng))
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let Placement { object, goal } = start.placement;
        let goal_distance = now.object.distance(goal);
        let margin = (object.distance(goal) - SUCCESS).abs();
        let turned = long_tail_reward(goal_distance, SUCCESS, margin);
        // as in Meta-World, the margin is the distance from the faucet's foot
        let far = (object.distance(start.task_state.tcp) - TOUCHING).abs();
        let reached = gaussian_reward(now.object.distance(now.tcp), TOUCHING, far);
        let success = goal_distance <= SUCCESS;
        StepReward {
            approach_reward: reached,
            in_place_reward: turned,
            goal_distance,
            reward: if success { 10.0 } else { 4.0 * reached + 6.0 * turned },
            success,
        }
    }

    /// Comes down on the right of the handle and pushes along its circle.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let turned = angle_to(TIP_AT_START, (now.object - placement.object).truncate());
        let at = |angle, point: DVec2| {
            let on_circle = DVec2::from_angle(angle).rotate(point);
            placement.object + on_circle.extend(HAND_ABOVE_BASE)
        };
        // as a rigid part of the handle would stand, so that the hand stays beside it
        let beside = at(turned, BESIDE_HANDLE);
        let hand = if is_down_at(now.hand, beside, 0.045) {
            // ahead along the circle: a straight push would slip off the tip
            at((turned - LEAD).max(TURNED), AGAINST_HANDLE)
        } else {
            come_down(now.hand, beside, CLEARANCE).unwrap_or(beside)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts { handed: true, ..scene(part!("faucet.xml").1, "handle_tip", TIP) }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_BACK,
            lowest_target: FAUCET_LOWEST,
            ..spec("faucet-close", |rng| {
                place(draw_at(0.0, [META_WORLD_X, META_WORLD_FAUCET_Y], rng))
            })
        })
    }
}

fn place(object: DVec3) -> Placement {
    Placement { object, goal: object + SHUT }
}

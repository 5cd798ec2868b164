//! Faucet Close: turn the handle of a faucet to the left.

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::approach::{come_down, is_down_at};
use super::{CANONICAL_X, META_WORLD_HAND_BACK, META_WORLD_X, angle_to, scene, spec, uniform};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, MetaWorldSpec, Placement, StepReward, Task, TaskParts,
};

/// Task of turning a faucet shut.
#[derive(Clone, Copy, Debug)]
pub struct FaucetClose;

const FAUCET_Y: std::ops::Range<f64> = 0.16..0.22;
const META_WORLD_FAUCET_Y: std::ops::Range<f64> = 0.2..0.25;
/// Lowest target of Meta-World's hand (metres): its table does not stop it.
const META_WORLD_LOWEST: f64 = -0.15;
/// Offset from the tip of the handle to the point that the reward reads (metres).
const TIP: DVec3 = DVec3::new(0.0, 0.0, -0.01);
/// Position of that point on an open faucet, from the axis (metres).
const TIP_AT_START: DVec2 = DVec2::new(0.015, -0.175);
/// Offset from the faucet to the target of that point (metres).
const SHUT: DVec3 = DVec3::new(-0.175, 0.0, 0.125);
/// Distances of the point from its target at success, and of the fingertips from it at full reward
/// (metres).
const SUCCESS: f64 = 0.07;
const TOUCHING: f64 = 0.01;

/// Places of the expert's hand relative to the axis of an open faucet (metres): on the right of the
/// handle, and ahead while it pushes.
const BESIDE_HANDLE: DVec2 = DVec2::new(0.045, -0.165);
const AGAINST_HANDLE: DVec2 = DVec2::new(0.045, -0.15);
/// Height of the expert's hand on the faucet, and of its way there above that (metres).
const HAND_HEIGHT: f64 = 0.145;
const CLEARANCE: f64 = 0.08;
/// Angle by which the expert is ahead of the handle (radians).
const LEAD: f64 = 0.4;
/// Angle of a shut faucet (radians), beyond which the expert turns no further.
const TURNED: f64 = -1.5;

impl Task for FaucetClose {
    fn name(&self) -> &str {
        "faucet-close"
    }

    fn draw_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, FAUCET_Y), 0.0);
        Placement { object, goal: object + SHUT }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let Placement { object, goal } = start.placement;
        let goal_distance = now.object.distance(goal);
        let margin = (object.distance(goal) - SUCCESS).abs();
        let turned = long_tail_reward(goal_distance, SUCCESS, margin);
        // as in Meta-World, the margin is the distance from the faucet's foot
        let far = (object.distance(start.measurement.tcp) - TOUCHING).abs();
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
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let turned = angle_to(TIP_AT_START, (now.object - placement.object).truncate());
        let at = |angle, point: DVec2| {
            let on_circle = DVec2::from_angle(angle).rotate(point);
            placement.object + on_circle.extend(HAND_HEIGHT)
        };
        let beside = at(turned, BESIDE_HANDLE);
        let hand = if is_down_at(now.hand, beside, 0.045) {
            at((turned - LEAD).max(TURNED), AGAINST_HANDLE)
        } else {
            come_down(now.hand, beside, CLEARANCE).unwrap_or(beside)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskParts<'_> {
        TaskParts { handed: true, ..scene(part!("faucet.xml").1, "handle_tip", TIP) }
    }

    fn meta_world_spec(&self) -> Option<MetaWorldSpec<'_>> {
        Some(MetaWorldSpec {
            hand_target: META_WORLD_HAND_BACK,
            lowest_target: META_WORLD_LOWEST,
            ..spec("faucet-close", place_meta_world)
        })
    }
}

fn place_meta_world(rng: &mut ChaCha8Rng) -> Placement {
    let object = DVec3::new(uniform(rng, META_WORLD_X), uniform(rng, META_WORLD_FAUCET_Y), 0.0);
    Placement { object, goal: object + SHUT }
}

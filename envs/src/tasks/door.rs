//! Door Open and Door Close: turn the door of a cabinet on its hinges by the handle.

use std::f64::consts::PI;
use std::ops::Range;

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::caging::{come_down, is_down_at};
use super::{angle_to, draw_at, scene, spec};
use crate::mjcf::part;
use crate::reward::{gaussian_reward, hamacher_product, long_tail_reward};
use crate::task::{
    EpisodeStart, ExpertCommand, MetaWorldTaskSettings, Placement, StepReward, Task,
    TaskSceneParts, TaskState,
};

/// Task of pulling a door open.
#[derive(Clone, Copy, Debug)]
pub struct DoorOpen;

/// Task of pushing a door shut.
#[derive(Clone, Copy, Debug)]
pub struct DoorClose;

/// Position of the hinge relative to the cabinet (metres).
const HINGE: DVec3 = DVec3::new(-0.185, -0.1, 0.0);
/// Position of the handle's centre relative to the hinge of a shut door (metres).
const HANDLE: DVec2 = DVec2::new(0.37572163014973, -0.10713989547548);
/// Joint position of the open door (radians); 0 is shut. Meta-World's right angle has five digits.
#[expect(clippy::approx_constant, reason = "another number than the right angle")]
const OPEN: f64 = -1.5708;
/// Angle beyond which the expert turns an open door no further (radians).
const WIDE_OPEN: f64 = -1.75;

/// Offset from the cabinet to the target of an open door's handle (metres).
const OPEN_TARGET: DVec3 = DVec3::new(-0.3, -0.45, 0.0);
/// Offset from the cabinet to the target of a shut door's handle (metres).
const SHUT_TARGET: DVec3 = DVec3::new(0.2, -0.2, 0.0);
/// Distance of the handle from its target at success (metres); along x for an open door.
const SUCCESS: f64 = 0.08;
/// Distance of a shut door's handle from its target at full reward (metres).
const BOUND: f64 = 0.05;

/// Range of the cabinet along x (metres).
const CABINET_X: Range<f64> = 0.05..0.10;
/// Range of the cabinet along y (metres).
const CABINET_Y: Range<f64> = 0.22..0.26;
/// Height of the cabinet's centre (metres): low, so that a wrist passes above its door.
const CABINET_Z: f64 = 0.1;
/// Range of Meta-World's cabinet along x (metres).
const META_WORLD_CABINET_X: Range<f64> = 0.0..0.1;
/// Range of Meta-World's cabinet along y (metres).
const META_WORLD_CABINET_Y: Range<f64> = 0.25..0.35;
/// Height of the centre of Meta-World's cabinet (metres).
const META_WORLD_CABINET_Z: f64 = 0.15;
/// Start of the hand in Door Close (metres): on the left, clear of the open door, and as low as the
/// handle, so that the hand meets the door on its way to the handle's target.
const HAND_FAR_LEFT: DVec3 = DVec3::new(-0.25, -0.05, 0.14);
/// Start of Meta-World's hand in Door Close (metres).
const META_WORLD_HAND_FAR_LEFT: DVec3 = DVec3::new(-0.5, 0.0, 0.2);

/// Place of the expert's hand behind the handle's bar, from the hinge of a shut door (metres).
const BEHIND_BAR: DVec2 = DVec2::new(0.375, -0.068);
/// Place of the expert's hand in front of the door, from the hinge of a shut door (metres).
const BEFORE_DOOR: DVec2 = DVec2::new(0.28, -0.06);
/// Place of the expert's hand while it pushes, from the hinge of a shut door (metres).
const AGAINST_DOOR: DVec2 = DVec2::new(0.28, -0.02);
/// Height of the expert's hand above the hinge, whose height the handle has (metres).
const HAND_ABOVE_HINGE: f64 = 0.02;
/// Height of the hand's way there above that (metres).
const CLEARANCE: f64 = 0.09;
/// Angle by which the expert is ahead of the door (radians).
const LEAD: f64 = 0.35;

impl Task for DoorOpen {
    fn name(&self) -> &str {
        "door-open"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_cabinet(rng), OPEN_TARGET)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, finger: f64) -> StepReward {
        let goal_distance = (now.object.x - start.placement.goal.x).abs();
        let ready = is_ready(now);
        let opened = openness(angle(&start.placement, now));
        // closed fingers earn all of it, although nothing is gripped: Meta-World hooks the bar
        let closing = (finger.clamp(-1.0, 1.0) + 1.0) / 2.0;
        let success = goal_distance <= SUCCESS;
        StepReward {
            approach_reward: ready,
            in_place_reward: opened,
            goal_distance,
            // the full reward at success, although the door could open wider
            reward: if success {
                10.0
            } else {
                2.0 * hamacher_product(ready, closing) + 8.0 * opened
            },
            success,
        }
    }

    /// Comes down behind the bar of the handle and pulls along its circle.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let turned = angle(placement, now);
        let hook = on_door(placement, turned, BEHIND_BAR);
        let hand = if is_down_at(now.hand, hook, 0.045) {
            // ahead of the door, so that the hand pulls, and no further than the arm reaches
            on_door(placement, (turned - LEAD).max(WIDE_OPEN), BEHIND_BAR)
        } else {
            come_down(now.hand, hook, CLEARANCE).unwrap_or(hook)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts { handed: true, ..scene(part!("door.xml").1, "handle", DVec3::ZERO) }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(spec("door-open", |rng| place(draw_meta_world_cabinet(rng), OPEN_TARGET)))
    }
}

impl Task for DoorClose {
    fn name(&self) -> &str {
        "door-close"
    }

    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        place(draw_cabinet(rng), SHUT_TARGET)
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let Placement { object, goal } = start.placement;
        let goal_distance = now.object.distance(goal);
        let shut = gaussian_reward(goal_distance, BOUND, object.distance(goal));
        // as in Meta-World, the hand is drawn to the handle's target, not to the handle
        let margin = start.hand_target.distance(now.object) + 0.1;
        let followed = gaussian_reward(now.tcp.distance(goal), 0.25 * BOUND, margin);
        StepReward {
            approach_reward: followed,
            in_place_reward: shut,
            goal_distance,
            reward: if goal_distance < BOUND { 10.0 } else { 3.0 * followed + 6.0 * shut },
            success: goal_distance <= SUCCESS,
        }
    }

    /// Comes down in front of the open door and pushes it along its circle.
    fn expert(&self, placement: &Placement, now: &TaskState) -> ExpertCommand {
        let turned = angle(placement, now);
        let front = on_door(placement, turned, BEFORE_DOOR);
        let hand = if is_down_at(now.hand, front, 0.06) {
            // a lead makes the hand press on while the door turns away from it
            on_door(placement, turned + LEAD, AGAINST_DOOR)
        } else {
            come_down(now.hand, front, CLEARANCE).unwrap_or(front)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            start_joints: &[("hinge", OPEN)],
            hand_target: Some(HAND_FAR_LEFT),
            ..DoorOpen.parts()
        }
    }

    fn meta_world_settings(&self) -> Option<MetaWorldTaskSettings<'_>> {
        Some(MetaWorldTaskSettings {
            hand_target: META_WORLD_HAND_FAR_LEFT,
            ..spec("door-close", |rng| place(draw_meta_world_cabinet(rng), SHUT_TARGET))
        })
    }
}

fn place(object: DVec3, target: DVec3) -> Placement {
    Placement { object, goal: object + target }
}

fn draw_cabinet(rng: &mut ChaCha8Rng) -> DVec3 {
    draw_at(CABINET_Z, [CABINET_X, CABINET_Y], rng)
}

fn draw_meta_world_cabinet(rng: &mut ChaCha8Rng) -> DVec3 {
    draw_at(META_WORLD_CABINET_Z, [META_WORLD_CABINET_X, META_WORLD_CABINET_Y], rng)
}

/// Returns the angle of the door (radians), 0 if shut, which the place of its handle tells.
fn angle(placement: &Placement, now: &TaskState) -> f64 {
    // measured, not read from the joint: experts see what rewards see
    angle_to(HANDLE, (now.object - placement.object - HINGE).truncate())
}

/// Returns the place of the hand at `point` (metres, from the hinge of a shut door) of a door that
/// has turned by `angle` (radians).
fn on_door(placement: &Placement, angle: f64, point: DVec2) -> DVec3 {
    let turned = DVec2::from_angle(angle).rotate(point);
    placement.object + HINGE + turned.extend(HAND_ABOVE_HINGE)
}

/// Returns the reward in `[0, 1]` of a hand between handle and door that came there from above.
fn is_ready(now: &TaskState) -> f64 {
    /// Radius of the funnel above the handle, through which the hand should come (metres).
    const FUNNEL: f64 = 0.12;
    // the bar stands 5 cm in front of the door
    let handle = now.object - DVec3::new(0.05, 0.0, 0.0);
    let beside = (now.hand - handle).truncate().length() - FUNNEL;
    // outside the funnel the hand should be above a floor that rises like a logarithm
    let floor = if beside <= 0.0 { 0.0 } else { 0.04 * beside.ln() + 0.4 };
    let above = if now.hand.z >= floor {
        1.0
    } else {
        long_tail_reward(floor - now.hand.z, 0.01, floor / 2.0)
    };
    let between = handle + DVec3::new(0.05, 0.03, -0.01);
    let near = long_tail_reward(now.hand.distance(between), FUNNEL / 2.0, 0.5);
    hamacher_product(above, near)
}

/// Returns the reward in `[0, 1]` of a door at `angle` (radians): a fifth for opening it at all.
fn openness(angle: f64) -> f64 {
    let ajar = if angle < -PI / 90.0 { 0.2 } else { 0.0 };
    // a door that is pressed beyond its stop loses reward again
    let left = PI / 2.0 + PI / 6.0 + angle;
    let bound = if left < 0.0 { 0.0 } else { 0.5 };
    ajar + 0.8 * long_tail_reward(left.abs(), bound, PI / 3.0)
}

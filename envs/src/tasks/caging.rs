//! Rewards of a gripper that holds an object between its fingers, and the ways of experts' hands to
//! what they push, pull or take.

use glam::{DVec2, DVec3};

use crate::reward::{hamacher_product, long_tail_interval_reward, long_tail_reward};
use crate::task::{EpisodeStart, ExpertCommand, TaskState};

/// Distance of the fingertips from the object in the plane of x and z at full reward (metres).
const IN_LINE: f64 = 0.005;
/// Reward of the place of the fingers from which on closing them pays.
const CAGED: f64 = 0.97;

/// Returns Meta-World's dense caging reward in `[0, 1]`, for finger pads on both sides of the
/// object and the finger action `finger` that closes them. It is full for pads whose distances from
/// the object along y are in `[low, high]` (metres).
pub(super) fn caging_reward(
    start: &EpisodeStart,
    now: &TaskState,
    [low, high]: [f64; 2],
    finger: f64,
) -> f64 {
    let beside = now.pads.map(|pad| {
        // the margin follows the pad: far from where the object was, any distance is good
        let margin = ((pad - start.placement.object.y).abs() - high).abs();
        long_tail_interval_reward((pad - now.object.y).abs(), [low, high], margin)
    });
    with_pads(beside, start, now, finger)
}

/// Returns the caging reward in `[0, 1]`, see [`caging_reward`], for finger pads each of which must
/// be on its own side of the object.
pub(super) fn sided_caging_reward(
    start: &EpisodeStart,
    now: &TaskState,
    [low, high]: [f64; 2],
    finger: f64,
) -> f64 {
    let [right, left] = now.pads;
    let beside = [now.object.y - right, left - now.object.y].map(|distance| {
        let margin = (distance.abs() - high).abs();
        long_tail_interval_reward(distance, [low, high], margin)
    });
    with_pads(beside, start, now, finger)
}

fn with_pads([right, left]: [f64; 2], start: &EpisodeStart, now: &TaskState, finger: f64) -> f64 {
    let flat = |point: DVec3| DVec2::new(point.x, point.z);
    let distance = flat(now.tcp).distance(flat(now.object));
    let at_start = flat(start.placement.object).distance(flat(start.task_state.tcp));
    let in_line = long_tail_reward(distance, IN_LINE, at_start - IN_LINE);
    // all three must hold: a pad on either side, and fingertips at the object's height
    let caging = hamacher_product(hamacher_product(left, right), in_line);
    let gripping = if caging > CAGED { finger.clamp(0.0, 1.0) } else { 0.0 };
    (hamacher_product(caging, gripping) + caging) / 2.0
}

/// Height by which an object is lifted (metres).
const LIFTED: f64 = 0.01;

/// Returns `true` if the object is within `reach` (metres) of the point between the fingertips,
/// which are not fully closed.
pub(super) fn is_held(now: &TaskState, reach: f64) -> bool {
    // as in Meta-World, fingers that closed on nothing hold nothing
    now.object.distance(now.tcp) < reach && now.aperture > 0.0
}

/// Returns `true` if the object is more than 1 cm above its position at the start of the episode.
pub(super) fn is_lifted(start: &EpisodeStart, now: &TaskState) -> bool {
    now.object.z - LIFTED > start.placement.object.z
}

/// Distance in the plane within which the hand comes down (metres).
const OVER: f64 = 0.03;
/// Distance in the plane up to which a hand that is not over its aim may stay low (metres): it is
/// on its way out, and objects are farther than that.
const CLOSE: f64 = 0.06;
/// Tolerance of the height of the hand's way, and of a hand that has come down (metres).
const HEIGHT_TOLERANCE: f64 = 0.03;
/// Height above the aim at which the hand stops coming down (metres): a hand that a weld pulls
/// hangs some millimetres low or high.
const DOWN: f64 = 0.02;

/// Returns the next target of a hand that is to come down to `aim` from `clearance` (metres) above
/// it: up, over, then down. `None` once it is there.
pub(super) fn come_down(hand: DVec3, aim: DVec3, clearance: f64) -> Option<DVec3> {
    let over = aim + clearance * DVec3::Z;
    let beside = (hand - aim).truncate().length();
    if beside > CLOSE && hand.z < over.z - HEIGHT_TOLERANCE {
        // up first: a straight way would push the object over
        Some(DVec3::new(hand.x, hand.y, over.z))
    } else if beside > OVER {
        Some(over)
    } else {
        (hand.z - aim.z > DOWN).then_some(aim)
    }
}

/// Returns `true` if the hand is within `reach` (metres) of `aim` horizontally, and less than 3 cm
/// above it or lower.
pub(super) fn is_down_at(hand: DVec3, aim: DVec3, reach: f64) -> bool {
    (hand - aim).truncate().length() < reach && hand.z - aim.z < HEIGHT_TOLERANCE
}

/// Aperture of fingers that have begun to close: those of the widest grip stop at 0.91.
const CLOSING: f64 = 0.93;
/// Distances beside and above the grip from which fingers close (metres).
const READY: [f64; 2] = [0.008, 0.012];
/// Distances beside and above the grip up to which closed fingers hold (metres): a held object
/// slips a little, and opening for that would drop it.
const HOLDS: [f64; 2] = [0.02, 0.025];
/// Share of its way that the hand covers in a decision: an arm that lags would overshoot with more.
const GAIN: f64 = 0.5;

/// Way that the hand starts with while its object does not follow (metres): the fingers may still
/// be closing, and would lose an object that they left at full speed.
const FIRST_WAY: f64 = 0.02;
/// Way of an object that follows the hand (metres).
const FOLLOWS: f64 = 0.005;

/// Returns the command of an expert that takes an object with the hand at `grip`, and then carries
/// it with the hand to `to`. `moved` is the object's way from its start that the fingers are to
/// cause (metres).
pub(super) fn take_and_carry(now: &TaskState, grip: DVec3, to: DVec3, moved: f64) -> ExpertCommand {
    let beside = (now.hand - grip).truncate().length();
    // looser bounds once the fingers close, so that the hand does not waver between two states
    let [near, low] = if now.aperture > CLOSING { READY } else { HOLDS };
    let (way, finger) = if beside >= near || now.hand.z - grip.z >= low {
        // down a funnel, so that no finger comes down on the object
        let above = 0.1 * ((beside - 0.004) / 0.03).clamp(0.0, 1.0);
        (grip + above * DVec3::Z - now.hand, -1.0)
    } else if now.aperture > CLOSING {
        (grip - now.hand, 1.0)
    } else {
        let longest = if moved > FOLLOWS { f64::INFINITY } else { FIRST_WAY };
        ((to - now.hand).clamp_length_max(longest), 1.0)
    };
    ExpertCommand { hand: now.hand + GAIN * way, finger }
}

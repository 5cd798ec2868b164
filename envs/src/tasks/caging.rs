//! Reward of a gripper that holds an object between its fingers, and how an expert takes one.

use glam::{DVec2, DVec3};

use crate::reward::{hamacher_product, long_tail_between, long_tail_reward};
use crate::task::{EpisodeStart, Measurement};

/// Distance of the fingertips from the object in the plane of x and z at full reward (metres).
const IN_LINE: f64 = 0.005;
/// Reward of the place of the fingers from which on closing them pays.
const CAGED: f64 = 0.97;

/// Returns the reward in `[0, 1]` of fingers around the object and of the finger action `finger`,
/// in Meta-World's dense form. It is full for pads whose distances from the object along y are in
/// `[low, high]` (metres).
pub(super) fn caging_reward(
    start: &EpisodeStart,
    now: &Measurement,
    [low, high]: [f64; 2],
    finger: f64,
) -> f64 {
    let beside = now.pads.map(|pad| {
        // the margin follows the pad: far from where the object was, any distance is good
        let margin = ((pad - start.placement.object.y).abs() - high).abs();
        long_tail_between((pad - now.object.y).abs(), [low, high], margin)
    });
    with_pads(beside, start, now, finger)
}

/// Returns the same reward where each pad must be on its own side of the object.
pub(super) fn sided_caging_reward(
    start: &EpisodeStart,
    now: &Measurement,
    [low, high]: [f64; 2],
    finger: f64,
) -> f64 {
    let [right, left] = now.pads;
    let beside = [now.object.y - right, left - now.object.y].map(|distance| {
        let margin = (distance.abs() - high).abs();
        long_tail_between(distance, [low, high], margin)
    });
    with_pads(beside, start, now, finger)
}

fn with_pads([right, left]: [f64; 2], start: &EpisodeStart, now: &Measurement, finger: f64) -> f64 {
    let flat = |point: DVec3| DVec2::new(point.x, point.z);
    let distance = flat(now.tcp).distance(flat(now.object));
    let at_start = flat(start.placement.object).distance(flat(start.measurement.tcp));
    let in_line = long_tail_reward(distance, IN_LINE, at_start - IN_LINE);
    let caging = hamacher_product(hamacher_product(left, right), in_line);
    let gripping = if caging > CAGED { finger.clamp(0.0, 1.0) } else { 0.0 };
    (hamacher_product(caging, gripping) + caging) / 2.0
}

/// Aperture of fingers that have begun to close: those of the widest grip stop at 0.91.
const CLOSING: f64 = 0.93;

/// Returns where the hand goes to take an object with the grip at `aim`, and how the fingers move
/// (1 closes). `None` once the hand is there and the fingers close.
pub(super) fn take(now: &Measurement, aim: DVec3) -> Option<(DVec3, f64)> {
    let beside = (now.hand - aim).truncate().length();
    if beside < 0.02 && now.hand.z - aim.z < 0.025 {
        return (now.aperture > CLOSING).then_some((aim, 1.0));
    }
    // down a funnel, so that no finger comes down on the object
    let above = 0.1 * ((beside - 0.005) / 0.03).clamp(0.0, 1.0);
    Some((aim + above * DVec3::Z, -1.0))
}

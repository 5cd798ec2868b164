//! Reward of a gripper that holds an object between its fingers, and how an expert takes one.

use glam::{DVec2, DVec3};

use crate::reward::{hamacher_product, long_tail_between, long_tail_reward};
use crate::task::{EpisodeStart, ExpertCommand, Measurement};

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
/// Distances beside and above the grip (metres) from which fingers close, and up to which closed
/// ones hold.
const READY: [f64; 2] = [0.008, 0.012];
const HOLDS: [f64; 2] = [0.02, 0.025];
/// Share of its way that the hand covers in a decision: an arm that lags would overshoot with more.
const GAIN: f64 = 0.5;

/// Returns the command for an object to be taken with the hand at `grip`, and then carried with the
/// hand to `to`.
pub(super) fn take_and_carry(now: &Measurement, grip: DVec3, to: DVec3) -> ExpertCommand {
    let beside = (now.hand - grip).truncate().length();
    let [near, low] = if now.aperture > CLOSING { READY } else { HOLDS };
    let (way, finger) = if beside >= near || now.hand.z - grip.z >= low {
        // down a funnel, so that no finger comes down on the object
        let above = 0.1 * ((beside - 0.004) / 0.03).clamp(0.0, 1.0);
        (grip + above * DVec3::Z - now.hand, -1.0)
    } else if now.aperture > CLOSING {
        (grip - now.hand, 1.0)
    } else {
        (to - now.hand, 1.0)
    };
    ExpertCommand { hand: now.hand + GAIN * way, finger }
}

//! Way of the scripted experts to a place that the hand must come down to.

use glam::DVec3;

/// Distance in the plane from which the hand comes down (metres), and the distance up to which it
/// may stay low.
const OVER: f64 = 0.03;
const CLOSE: f64 = 0.06;
/// Height over the aim at which the hand has come down, and the tolerance of a height (metres).
const DOWN: f64 = 0.02;

/// Returns the next place of a hand that is to come down to `aim` from `clearance` above it
/// (metres): up, over, then down. `None` once it is there.
pub(super) fn come_down(hand: DVec3, aim: DVec3, clearance: f64) -> Option<DVec3> {
    let over = aim + clearance * DVec3::Z;
    let beside = (hand - aim).truncate().length();
    if beside > CLOSE && hand.z < over.z - OVER {
        Some(DVec3::new(hand.x, hand.y, over.z))
    } else if beside > OVER {
        Some(over)
    } else {
        (hand.z - aim.z > DOWN).then_some(aim)
    }
}

/// Returns `true` if the hand is within `reach` of `aim` in the plane, and not above it (metres).
pub(super) fn is_down_at(hand: DVec3, aim: DVec3, reach: f64) -> bool {
    (hand - aim).truncate().length() < reach && hand.z - aim.z < OVER
}

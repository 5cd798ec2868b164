//! Ranges of joints that others follow, reduced so that the followers stay within their own.

use crate::description::{Joint, JointMotionSpec, JointPositionSource, JointRangeRestriction};
use crate::error::MAX_NUMBER;

/// Rounding of a file's numbers (radians, metres): a follower may leave its range by this much, and
/// a range that is no wider counts as empty.
const ROUNDING: f64 = 1e-6;
/// Range that stands for no limits: the largest numbers that a file may hold.
const ENDLESS: [f64; 2] = [-MAX_NUMBER, MAX_NUMBER];

/// Reduces the ranges of free joints until each joint that follows one stays in its own range.
/// Returns the reductions, in order. A follower that cannot loses its range, and `note` gets its
/// index.
pub(super) fn restrict(
    joints: &mut [Joint],
    mut note: impl FnMut(usize, String),
) -> Vec<JointRangeRestriction> {
    let is_free = |joint: &Joint| joint.motion.is_some_and(|motion| motion.is_free());
    let free: Vec<usize> = (0..joints.len()).filter(|&joint| is_free(&joints[joint])).collect();
    let range_of = |joint: &Joint| joint.motion.and_then(|motion| motion.range);
    let stated: Vec<_> = free.iter().map(|&joint| range_of(&joints[joint])).collect();
    let mut restrictions: Vec<JointRangeRestriction> = Vec::new();
    for index in 0..joints.len() {
        let follower = &joints[index];
        let Some(motion) = follower.motion else {
            continue;
        };
        let (JointPositionSource::Follows { dof, multiplier, offset }, Some(own)) =
            (motion.drive, motion.range)
        else {
            continue;
        };
        let leader = &joints[free[dof]];
        // earlier followers may have reduced it already
        let whole = range_of(leader).unwrap_or(ENDLESS);
        let Some(range) = narrowed(whole, own, multiplier, offset) else {
            let ([low, high], leader) = (own, &leader.name);
            let joint = &joints[index].name;
            note(
                index,
                format!(
                    "the joint `{joint}` follows `{leader}` and cannot stay within its own range, \
                     {low} to {high}, which is ignored"
                ),
            );
            joints[index].motion = Some(JointMotionSpec { range: None, ..motion });
            continue;
        };
        if range == whole {
            continue;
        }
        restrictions.push(JointRangeRestriction {
            joint: leader.name.clone(),
            follower: follower.name.clone(),
            file_range: stated[dof],
            range,
        });
        if let Some(followed) = &mut joints[free[dof]].motion {
            followed.range = Some(range);
        }
    }
    restrictions
}

/// Returns the part of the range `whole` in which the follower stays within its `own` range.
/// `None` if nothing is left.
fn narrowed(whole: [f64; 2], own: [f64; 2], multiplier: f64, offset: f64) -> Option<[f64; 2]> {
    if own[0] > own[1] || whole[0] > whole[1] {
        return None;
    }
    let led = ordered(whole.map(|end| multiplier * end + offset));
    let is_range = own[0] < own[1];
    if is_range && own[0] - ROUNDING <= led[0] && led[1] <= own[1] + ROUNDING {
        return Some(whole);
    }
    // with a multiplier of zero the follower stays at its offset
    if multiplier == 0.0 {
        return None;
    }
    let allowed = ordered(own.map(|end| (end - offset) / multiplier));
    let range = [whole[0].max(allowed[0]), whole[1].min(allowed[1])];
    (range[1] - range[0] > ROUNDING).then_some(range)
}

fn ordered([a, b]: [f64; 2]) -> [f64; 2] {
    [a.min(b), a.max(b)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_narrowed_to_what_followers_allow() {
        let whole = [-1.0, 2.0];
        for (leader, own, multiplier, offset, expected) in [
            (whole, [-3.0, 3.0], 1.5, 0.0, Some(whole)),
            (whole, [0.0, 1.0], 0.5, 0.25, Some([-0.5, 1.5])),
            (whole, [0.0, 1.0], -0.5, 0.25, Some([-1.0, 0.5])),
            (whole, [0.0, 1.0], 0.0, 0.5, Some(whole)),
            (whole, [0.0, 1.0], -0.0, 0.5, Some(whole)),
            (whole, [0.0, 1.0], 0.0, 1.5, None),
            (whole, [0.0, 1.0], -0.0, -0.5, None),
            (whole, [3.0, 4.0], 1.0, 0.0, None),
            // figures of a file are rounded
            (whole, [-1.0 + 9e-7, 2.0 - 9e-7], 1.0, 0.0, Some(whole)),
            // the ranges touch in one point, or in less than such figures say
            (whole, [2.0, 4.0], 1.0, 0.0, None),
            (whole, [2.0 - 9e-7, 4.0], 1.0, 0.0, None),
            (whole, [2.0 - 2e-6, 4.0], 1.0, 0.0, Some([2.0 - 2e-6, 2.0])),
            (whole, [0.5, 0.5], 1.0, 0.0, None),
            (whole, [0.5, 0.5], 0.0, 0.5, None),
            // lower limits above the upper ones
            (whole, [3.0, -3.0], 1.5, 0.0, None),
            ([2.0, -1.0], [-3.0, 3.0], 1.5, 0.0, None),
            // a leader without end, and followers that it hardly moves
            (ENDLESS, [-1.0, 1.0], 0.5, 0.0, Some([-2.0, 2.0])),
            (ENDLESS, [-1.0, 1.0], 1e-5, 0.0, Some([-1e5, 1e5])),
            (ENDLESS, [-1.0, 1.0], 1e-9, 0.0, Some(ENDLESS)),
            (ENDLESS, [-1.0, 1.0], -1e-310, 0.0, Some(ENDLESS)),
            (ENDLESS, [0.0, 1.0], 1e-9, 0.0, Some([0.0, MAX_NUMBER])),
            (ENDLESS, [1.0, 2.0], 1e-9, 0.0, None),
            (ENDLESS, [1.0, 2.0], 0.0, 0.0, None),
            (whole, [-1.0, 1.0], 1e-310, 0.0, Some(whole)),
        ] {
            let range = narrowed(leader, own, multiplier, offset);
            let [range, expected] = [range, expected].map(|range| format!("{range:.9?}"));
            assert_eq!(range, expected, "{leader:?} {own:?} {multiplier} {offset}");
        }
    }

    /// Either order comes to the same range.
    #[test]
    fn two_followers_narrow_one_range() {
        let followers = [([0.0, 1.0], 1.0, 0.0), ([-2.0, 1.0], -2.0, 0.0)];
        for order in [[0, 1], [1, 0]] {
            let range = order.iter().try_fold([-3.0, 3.0], |whole, &index| {
                let (own, multiplier, offset): ([f64; 2], f64, f64) = followers[index];
                narrowed(whole, own, multiplier, offset)
            });
            assert_eq!(range, Some([0.0, 1.0]));
        }
    }
}

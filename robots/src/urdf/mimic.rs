//! Ranges of joints that others follow: a follower keeps to its own range, too.

use crate::description::{Drive, Joint, Restriction};
use crate::error::DescriptionError;

/// How far (radians, metres) a follower may leave its range: figures of a file are rounded.
const ROUNDING: f64 = 1e-6;

/// Makes ranges of free joints smaller until every joint that follows one is within its own, and
/// lists those that became smaller.
pub(super) fn restrict(joints: &mut [Joint]) -> Result<Vec<Restriction>, DescriptionError> {
    let is_free = |joint: &Joint| joint.motion.is_some_and(|motion| motion.is_free());
    let free: Vec<usize> = (0..joints.len())
        .filter(|&joint| is_free(&joints[joint]))
        .collect();
    let range_of = |joint: &Joint| joint.motion.and_then(|motion| motion.range);
    let stated: Vec<_> = free.iter().map(|&joint| range_of(&joints[joint])).collect();
    let mut restrictions = Vec::new();
    for index in 0..joints.len() {
        let follower = &joints[index];
        let Some(motion) = follower.motion else {
            continue;
        };
        let (
            Drive::Follows {
                dof,
                multiplier,
                offset,
            },
            Some(own),
        ) = (motion.drive, motion.range)
        else {
            continue;
        };
        let leader = &joints[free[dof]];
        // others may have made it smaller already
        let whole = range_of(leader).unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        let led = ordered(whole.map(|end| follow(end, multiplier, offset)));
        if own[0] - ROUNDING <= led[0] && led[1] <= own[1] + ROUNDING {
            continue;
        }
        let allowed = ordered(own.map(|end| (end - offset) / multiplier));
        let range = [whole[0].max(allowed[0]), whole[1].min(allowed[1])];
        // with a multiplier of zero the follower stays at its offset
        if multiplier == 0.0 || range[0] >= range[1] {
            return Err(DescriptionError::FollowerRange {
                joint: follower.name.clone(),
                followed: leader.name.clone(),
                led,
                range: own,
            });
        }
        restrictions.push(Restriction {
            joint: leader.name.clone(),
            follower: follower.name.clone(),
            stated: stated[dof],
            range,
        });
        if let Some(motion) = &mut joints[free[dof]].motion {
            motion.range = Some(range);
        }
    }
    Ok(restrictions)
}

/// Position of a follower; one that does not move stays where it is, however far the other goes.
fn follow(position: f64, multiplier: f64, offset: f64) -> f64 {
    if multiplier == 0.0 {
        return offset;
    }
    multiplier * position + offset
}

fn ordered([a, b]: [f64; 2]) -> [f64; 2] {
    [a.min(b), a.max(b)]
}

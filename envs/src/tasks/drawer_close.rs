//! Drawer Close: push an open drawer shut along +y.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, STOCK_X, scene, stock, uniform};
use crate::mjcf::part;
use crate::reward::{gaussian, hamacher, long_tail};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, Parts, Placement, StepReward, Stock, Task,
};

/// The drawer task.
#[derive(Clone, Copy, Debug)]
pub struct DrawerClose;

const CASE_Y: f64 = 0.3;
/// Joint position of the open drawer (metres); zero is shut.
const OPEN: f64 = -0.15;
/// Distances to the target at full reward and at success (metres).
const BOUND: f64 = 0.05;
const SUCCESS: f64 = 0.065;
/// Fingertips this near to the handle count as there (metres).
const NEAR: f64 = 0.005;
/// From the drawer body's origin to the point above its handle.
const HANDLE: DVec3 = DVec3::new(0.0, -0.16, 0.05);
/// From the case's origin to the target of that point: 0.05 m below where it can be, so distances
/// never vanish.
const SHUT: DVec3 = DVec3::new(0.0, -0.16, 0.09);

impl Task for DrawerClose {
    fn name(&self) -> &str {
        "drawer-close"
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), CASE_Y, 0.0);
        Placement { object, goal: object + SHUT }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let EpisodeStart { placement, measured, .. } = start;
        let remaining = now.object.distance(placement.goal);
        let at_start = measured.object.distance(placement.goal);
        let shut = long_tail(remaining, BOUND, (at_start - BOUND).abs());
        let way = (measured.object.distance(measured.tcp) - NEAR).abs();
        let reached = gaussian(now.object.distance(now.tcp), NEAR, way);
        let success = remaining <= SUCCESS;
        let pushing = hamacher(reached, finger.clamp(0.0, 1.0));
        StepReward {
            approach: pushing,
            in_place: shut,
            remaining,
            reward: if success { 10.0 } else { 10.0 * hamacher(pushing, shut) },
            success,
        }
    }

    /// Up and over to the near side of the handle, down, then push.
    fn expert(&self, _: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, 0.0, -0.02);
        let near_side = aim + DVec3::new(0.0, -0.075, 0.0);
        let hand = if now.hand.y > aim.y - 0.05 && (now.hand.z - aim.z) > 0.04 {
            if now.hand.z < aim.z + 0.10 {
                now.hand + DVec3::new(0.0, -0.02, 0.5)
            } else {
                near_side + DVec3::new(0.0, 0.0, 0.13)
            }
        } else if (now.hand.z - aim.z).abs() > 0.04 {
            near_side
        } else {
            aim + DVec3::new(0.0, 0.05, 0.0)
        };
        ExpertCommand { hand, finger: 1.0 }
    }

    fn parts(&self) -> Parts<'_> {
        Parts {
            start_joints: &[("slide", OPEN)],
            ..scene(part!("drawer_close.xml").1, "drawer", HANDLE)
        }
    }

    fn stock(&self) -> Option<Stock<'_>> {
        Some(stock("drawer-close", place_stock))
    }
}

fn place_stock(rng: &mut ChaCha8Rng) -> Placement {
    let object = DVec3::new(uniform(rng, STOCK_X), CASE_Y, 0.0);
    Placement { object, goal: object + SHUT }
}

//! Plate Slide: push a puck from the centre into a goal cage that opens to -y.

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, STOCK_HAND_START, STOCK_X, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher, long_tail};
use crate::scene::HAND_START;
use crate::task::{Evaluation, ExpertCommand, Measurement, Parts, Placement, Task};

const GOAL_Y: std::ops::Range<f64> = 0.25..0.30;
const PUCK_START: DVec3 = DVec3::new(0.0, 0.0, 0.015);
/// Meta-World measures the way from the puck's start on the table's surface, not from its centre.
const START_ON_TABLE: DVec3 = DVec3::ZERO;
/// Distances to the goal at full reward and at success (metres).
const BOUND: f64 = 0.05;
const SUCCESS: f64 = 0.07;

/// Nearer to the goal than this along y (metres), the expert's puck must be within this of it along x.
const POST: DVec2 = DVec2::new(0.045, 0.17);
/// How far ahead of the hand the expert aims along y where it must go sideways first (metres).
const SLOWLY: f64 = 0.01;

const PARTS: Parts = Parts {
    scene: Some(part!("plate_slide.xml")),
    object_body: Some("puck"),
    object_offset: DVec3::ZERO,
    start_joints: &[],
    tells_goal: false,
};

/// The plate task.
#[derive(Clone, Copy, Debug)]
pub struct PlateSlide;

impl Task for PlateSlide {
    fn parts(&self) -> &'static Parts {
        &PARTS
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        Placement {
            object: PUCK_START,
            hand_start: HAND_START,
            goal: DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, GOAL_Y), 0.0),
        }
    }

    fn place_stock(&self, rng: &mut ChaCha8Rng) -> Placement {
        Placement {
            object: PUCK_START,
            hand_start: STOCK_HAND_START,
            goal: DVec3::new(uniform(rng, STOCK_X), uniform(rng, GOAL_Y), 0.0),
        }
    }

    fn evaluate(
        &self,
        placement: &Placement,
        start: &Measurement,
        now: &Measurement,
        _: f64,
    ) -> Evaluation {
        let remaining = now.object.distance(placement.goal);
        let margin = START_ON_TABLE.distance(placement.goal);
        let placed = long_tail(remaining, BOUND, margin);
        let touching = long_tail(
            now.tcp.distance(now.object),
            BOUND,
            start.tcp.distance(START_ON_TABLE),
        );
        Evaluation {
            approach: touching,
            in_place: placed,
            remaining,
            reward: if remaining < BOUND {
                10.0
            } else {
                8.0 * hamacher(touching, placed)
            },
            success: remaining <= SUCCESS,
        }
    }

    /// Behind the puck on the line from the goal, down, then push towards the goal.
    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + DVec3::new(0.0, -0.055, 0.03);
        let off = (now.hand - aim).truncate().length();
        let hand = if off > 0.03 {
            aim + DVec3::new(0.0, 0.0, 0.1)
        } else if (now.hand.z - aim.z).abs() > 0.04 {
            aim
        } else {
            let ahead = placement.goal - now.object;
            // a puck that comes along the diagonal would meet the post of the cage
            let post = ahead.y < POST.y && ahead.x.abs() > POST.x;
            let y = if post {
                now.hand.y + SLOWLY
            } else {
                placement.goal.y
            };
            DVec3::new(placement.goal.x, y, aim.z)
        };
        ExpertCommand { hand, finger: -1.0 }
    }
}

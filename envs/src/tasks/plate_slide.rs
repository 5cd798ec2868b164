//! Plate Slide: push a puck from the centre into a goal cage that opens to -y.

use glam::{DVec2, DVec3};
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, STOCK_X, scene, stock, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher, long_tail};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, Parts, Placement, StepReward, Stock, Task,
};

/// The plate task.
#[derive(Clone, Copy, Debug)]
pub struct PlateSlide;

const GOAL_Y: std::ops::Range<f64> = 0.25..0.30;
const PUCK_START: DVec3 = DVec3::new(0.0, 0.0, 0.015);
/// Meta-World measures the way from the puck's start on the table's surface, not from its centre.
const START_ON_TABLE: DVec3 = DVec3::ZERO;
/// Distances to the goal at full reward and at success (metres).
const BOUND: f64 = 0.05;
const SUCCESS: f64 = 0.07;

/// Nearer to the goal than this along y (metres), the expert's puck must be within this of it along
/// x.
const POST: DVec2 = DVec2::new(0.045, 0.17);
/// How far ahead of the hand the expert aims along y where it must go sideways first (metres).
const SLOWLY: f64 = 0.01;

impl Task for PlateSlide {
    fn name(&self) -> &str {
        "plate-slide"
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        Placement {
            object: PUCK_START,
            goal: DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, GOAL_Y), 0.0),
        }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let goal = start.placement.goal;
        let remaining = now.object.distance(goal);
        let margin = START_ON_TABLE.distance(goal);
        let placed = long_tail(remaining, BOUND, margin);
        let touching = long_tail(
            now.tcp.distance(now.object),
            BOUND,
            start.measured.tcp.distance(START_ON_TABLE),
        );
        StepReward {
            approach: touching,
            in_place: placed,
            remaining,
            reward: if remaining < BOUND { 10.0 } else { 8.0 * hamacher(touching, placed) },
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
            let y = if post { now.hand.y + SLOWLY } else { placement.goal.y };
            DVec3::new(placement.goal.x, y, aim.z)
        };
        ExpertCommand { hand, finger: -1.0 }
    }

    fn parts(&self) -> Parts<'_> {
        scene(part!("plate_slide.xml").1, "puck", DVec3::ZERO)
    }

    fn stock(&self) -> Option<Stock<'_>> {
        Some(stock("plate-slide", place_stock))
    }
}

fn place_stock(rng: &mut ChaCha8Rng) -> Placement {
    Placement {
        object: PUCK_START,
        goal: DVec3::new(uniform(rng, STOCK_X), uniform(rng, GOAL_Y), 0.0),
    }
}

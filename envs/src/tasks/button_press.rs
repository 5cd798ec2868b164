//! Button Press: push a button that faces -y into its box.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use super::{CANONICAL_X, STOCK_X, scene, stock, uniform};
use crate::mjcf::part;
use crate::reward::{hamacher, long_tail};
use crate::task::{
    EpisodeStart, ExpertCommand, Measurement, Parts, Placement, StepReward, Stock, Task,
};

/// The button task.
#[derive(Clone, Copy, Debug)]
pub struct ButtonPress;

/// Box centre along y (metres): nearer than Meta-World's 0.25..0.30, so that the arm reaches past
/// the press.
const BOX_Y: std::ops::Range<f64> = 0.22..0.27;
const STOCK_BOX_Y: std::ops::Range<f64> = 0.25..0.30;
const STOCK_HAND_START: DVec3 = DVec3::new(0.0, -0.2, 0.2);
const BOX_Z: f64 = 0.115;
/// From the button body's origin to the middle of its cap.
const CAP: DVec3 = DVec3::new(0.0, -0.193, 0.0);
/// From the box's centre to where a fully pressed cap would be.
const HOLE: DVec3 = DVec3::new(0.0, -0.1, 0.0);
/// Way from rest to the hole (metres), the reward's margin.
const TRAVEL: f64 = 0.0935;
/// Remaining way at success and at full reward (metres).
const SUCCESS: f64 = 0.02;
const PRESSED: f64 = 0.005;
/// Fingertips this near to the cap count as touching (metres).
const NEAR: f64 = 0.05;

impl Task for ButtonPress {
    fn name(&self) -> &str {
        "button-press"
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        let object = DVec3::new(uniform(rng, CANONICAL_X), uniform(rng, BOX_Y), BOX_Z);
        Placement { object, goal: object + HOLE }
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, _: f64) -> StepReward {
        let remaining = (start.placement.goal.y - now.object.y).abs();
        let distance = now.object.distance(now.tcp);
        let near = long_tail(distance, NEAR, now.object.distance(start.measured.tcp));
        let pressed = long_tail(remaining, PRESSED, TRAVEL);
        let touching = if distance <= NEAR { 1.0 } else { 0.0 };
        StepReward {
            approach: near,
            in_place: pressed,
            remaining,
            reward: 2.0 * hamacher(now.aperture, near) + 8.0 * pressed * touching,
            success: remaining <= SUCCESS,
        }
    }

    /// First in front of the cap, well clear of it, then straight through.
    fn expert(&self, _: &Placement, now: &Measurement) -> ExpertCommand {
        let aim = now.object + (now.hand - now.tcp);
        let off_axis = (now.hand.x - aim.x).abs().max((now.hand.z - aim.z).abs());
        let hand = if off_axis > 0.02 {
            DVec3::new(aim.x, now.hand.y.min(aim.y - 0.1), aim.z)
        } else {
            aim + DVec3::new(0.0, 0.1, 0.0)
        };
        ExpertCommand { hand, finger: 0.0 }
    }

    fn parts(&self) -> Parts<'_> {
        scene(part!("button_press.xml").1, "button", CAP)
    }

    fn stock(&self) -> Option<Stock<'_>> {
        Some(Stock { hand_target: STOCK_HAND_START, ..stock("button-press", place_stock) })
    }
}

fn place_stock(rng: &mut ChaCha8Rng) -> Placement {
    let object = DVec3::new(uniform(rng, STOCK_X), uniform(rng, STOCK_BOX_Y), BOX_Z);
    Placement { object, goal: object + HOLE }
}

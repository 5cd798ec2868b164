//! The four tasks, one file each: figures at the top, then where things go, what is rewarded, how
//! an expert does it, and what the scene is made of.

mod button_press;
mod drawer_close;
mod goal_reach;
mod plate_slide;

pub use button_press::ButtonPress;
pub use drawer_close::DrawerClose;
pub use goal_reach::GoalReach;
pub use plate_slide::PlateSlide;

use std::ops::Range;

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::task::{Parts, Placement, Stock};

/// Canonical x of every object and goal (metres): right of the centre, so that a flip along x gives
/// a different task.
const CANONICAL_X: Range<f64> = 0.08..0.20;

/// Meta-World's x of every object and goal (metres).
const STOCK_X: Range<f64> = -0.1..0.1;
/// Where Meta-World's hand starts (metres), but for the button.
const STOCK_HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.2);

/// The parts of a task about a body of its scene, of which it reads the point at `offset`.
fn scene(mjcf: &'static str, body: &'static str, offset: DVec3) -> Parts<'static> {
    Parts { mjcf: Some(mjcf), object_body: Some(body), object_offset: offset, ..Parts::default() }
}

/// Meta-World's figures of a task whose scene has no addition.
fn stock(name: &'static str, place: fn(&mut ChaCha8Rng) -> Placement) -> Stock<'static> {
    Stock { name, hand_target: STOCK_HAND_START, addition: None, place }
}

fn uniform(rng: &mut ChaCha8Rng, range: Range<f64>) -> f64 {
    range.start + (range.end - range.start) * rng.random::<f64>()
}

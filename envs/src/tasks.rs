//! Tasks of the paper, one file each: constants, placement, reward, scripted expert, and parts of
//! the scene.

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

use crate::task::{MetaWorldSpec, Placement, TaskParts};

/// Canonical x of every object and goal (metres): right of the centre, so that a flip along x gives
/// a different task.
const CANONICAL_X: Range<f64> = 0.08..0.20;

/// Meta-World's x of every object and goal (metres).
const META_WORLD_X: Range<f64> = -0.1..0.1;
/// Start of Meta-World's hand (metres), except for Button Press.
const META_WORLD_HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.2);

/// Returns the parts of a task whose reference point is at `offset` from a body of its scene.
fn scene(mjcf: &'static str, body: &'static str, offset: DVec3) -> TaskParts<'static> {
    TaskParts {
        mjcf: Some(mjcf),
        object_body: Some(body),
        object_offset: offset,
        ..TaskParts::default()
    }
}

/// Returns Meta-World's settings for a task without an additional part.
fn spec(
    name: &'static str,
    draw_placement: fn(&mut ChaCha8Rng) -> Placement,
) -> MetaWorldSpec<'static> {
    MetaWorldSpec { name, hand_target: META_WORLD_HAND_START, extra_mjcf: None, draw_placement }
}

fn uniform(rng: &mut ChaCha8Rng, range: Range<f64>) -> f64 {
    range.start + (range.end - range.start) * rng.random::<f64>()
}

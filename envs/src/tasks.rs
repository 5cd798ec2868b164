//! Tasks of the paper and of Meta-World's MT10, one file for each object: constants, placement, reward, scripted expert, and parts of
//! the scene.

mod approach;
mod block;
mod button_press;
mod button_press_topdown;
mod caging;
mod door;
mod drawer_close;
mod drawer_open;
mod faucet_close;
mod goal_reach;
mod peg_insert_side;
mod plate_slide;
mod window;

pub use block::{PickPlace, Push};
pub use button_press::ButtonPress;
pub use button_press_topdown::ButtonPressTopdown;
pub use door::{DoorClose, DoorOpen};
pub use drawer_close::DrawerClose;
pub use drawer_open::DrawerOpen;
pub use faucet_close::FaucetClose;
pub use goal_reach::GoalReach;
pub use peg_insert_side::PegInsertSide;
pub use plate_slide::PlateSlide;
pub use window::{WindowClose, WindowOpen};

use std::ops::Range;

use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::task::{MetaWorldSpec, Placement, TaskParts};

/// Canonical x of every object and goal (metres): right of the centre, so that a flip along x gives
/// a different task.
const CANONICAL_X: Range<f64> = 0.08..0.20;

/// Meta-World's x of every object and goal (metres).
const META_WORLD_X: Range<f64> = -0.1..0.1;
/// Start of Meta-World's hand over the centre, and in tasks with high objects behind it (metres).
const META_WORLD_HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.2);
const META_WORLD_HAND_BACK: DVec3 = DVec3::new(0.0, -0.2, 0.2);
/// Lowest target of Meta-World's hand (metres).
const META_WORLD_LOWEST: f64 = 0.05;

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
    MetaWorldSpec {
        name,
        hand_target: META_WORLD_HAND_START,
        lowest_target: META_WORLD_LOWEST,
        extra_mjcf: None,
        draw_placement,
    }
}

fn uniform(rng: &mut ChaCha8Rng, range: Range<f64>) -> f64 {
    range.start + (range.end - range.start) * rng.random::<f64>()
}

/// Returns the angle (radians) from one direction to another; glam's `angle_to` is approximate.
fn angle_to(from: DVec2, to: DVec2) -> f64 {
    from.perp_dot(to).atan2(from.dot(to))
}

//! Tasks of the paper and of Meta-World's MT10, one file for each object: constants, placement,
//! reward, scripted expert, and parts of the scene.

mod block;
mod button;
mod caging;
mod door;
mod drawer;
mod faucet_close;
mod goal_reach;
mod peg_insert_side;
mod plate_slide;
mod window;

pub use block::{PickPlace, Push};
pub use button::{ButtonPress, ButtonPressTopdown};
pub use door::{DoorClose, DoorOpen};
pub use drawer::{DrawerClose, DrawerOpen};
pub use faucet_close::FaucetClose;
pub use goal_reach::GoalReach;
pub use peg_insert_side::PegInsertSide;
pub use plate_slide::PlateSlide;
pub use window::{WindowClose, WindowOpen};

use std::ops::Range;

use glam::{DVec2, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::task::{MetaWorldTaskSettings, Placement, TaskSceneParts, TaskState};

/// Canonical x of most objects and goals (metres): right of the centre, so that a flip along x
/// gives a different task. Windows, cabinets, blocks and pegs have ranges of their own.
const CANONICAL_X: Range<f64> = 0.08..0.20;

/// Meta-World's x of most objects and goals (metres); cabinets and pegs have ranges of their own.
const META_WORLD_X: Range<f64> = -0.1..0.1;
/// Start of Meta-World's hand over the centre (metres).
const META_WORLD_HAND_START: DVec3 = DVec3::new(0.0, 0.0, 0.2);
/// Start of Meta-World's hand in tasks with high objects (metres): behind the centre.
const META_WORLD_HAND_BACK: DVec3 = DVec3::new(0.0, -0.2, 0.2);
/// Lowest target of Meta-World's hand (metres).
const META_WORLD_LOWEST: f64 = 0.05;

/// Returns the parts of a task whose reference point is at `offset` from a body of its scene.
fn scene(mjcf: &'static str, body: &'static str, offset: DVec3) -> TaskSceneParts<'static> {
    TaskSceneParts {
        mjcf: Some(mjcf),
        object_body: Some(body),
        object_offset: offset,
        ..TaskSceneParts::default()
    }
}

/// Returns Meta-World's settings for a task without an additional part.
fn spec(
    name: &'static str,
    sample_placement: fn(&mut ChaCha8Rng) -> Placement,
) -> MetaWorldTaskSettings<'static> {
    MetaWorldTaskSettings {
        name,
        hand_target: META_WORLD_HAND_START,
        lowest_target: META_WORLD_LOWEST,
        start_joints: &[],
        extra_mjcf: None,
        sample_placement,
    }
}

fn uniform(rng: &mut ChaCha8Rng, range: Range<f64>) -> f64 {
    // not `random_range`, whose rounding may change between releases of `rand`
    range.start + (range.end - range.start) * rng.random::<f64>()
}

/// Draws a point at height `z` with x and y from their ranges (metres).
fn draw_at(z: f64, [x, y]: [Range<f64>; 2], rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::new(uniform(rng, x), uniform(rng, y), z)
}

/// Draws a point with coordinates from their ranges (metres).
fn draw_in([x, y, z]: [Range<f64>; 3], rng: &mut ChaCha8Rng) -> DVec3 {
    DVec3::new(uniform(rng, x), uniform(rng, y), uniform(rng, z))
}

/// Draws placements until object and goal are at least `distance` (metres) apart in the plane.
fn draw_apart(distance: f64, mut draw: impl FnMut() -> Placement) -> Placement {
    loop {
        let placement = draw();
        if (placement.goal - placement.object).truncate().length() >= distance {
            return placement;
        }
    }
}

/// Returns where the hand is when its fingertips are at `point` (metres): commands move the hand.
fn hand_for_tips(now: &TaskState, point: DVec3) -> DVec3 {
    point + (now.hand - now.tcp)
}

/// Returns the angle (radians) from one direction to another; glam's `angle_to` is approximate.
fn angle_to(from: DVec2, to: DVec2) -> f64 {
    // exact to the last bits, so that rewards are those of Meta-World
    from.perp_dot(to).atan2(from.dot(to))
}

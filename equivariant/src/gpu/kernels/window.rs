//! Where windows lie, for kernels.

use symmetry::Group;

use crate::gpu::step::Step;
use crate::shape::Shape;
use crate::window::Kernel;

/// Adds what `window.wgsl` needs, and that.
pub(super) fn windows(step: Step, kernel: Kernel, [from, to]: [Shape; 2]) -> Step {
    let step = step.constants([
        ("SIZE", kernel.size),
        ("STRIDE", kernel.stride),
        ("PADDING", kernel.padding),
        ("HEIGHT", from.height),
        ("WIDTH", from.width),
        ("OUT_PIXELS", to.pixels()),
        ("OUT_WIDTH", to.width),
        ("FLIPS", flips(from.fields.group())),
    ]);
    step.text(include_str!("../wgsl/window.wgsl"))
}

/// Adds a kernel that runs for each field, with the sum over taps of what is found there. `at_tap`
/// is `pixel_at`, for the pixels that a window sees, or `window_at`, for the windows that see one.
pub(super) fn sum_over_taps(step: Step, at_tap: &str) -> Step {
    let head = "fn at_tap(place: u32, tap: vec2<u32>) -> i32";
    step.text(&format!("{head} {{ return {at_tap}(place, tap); }}"))
        .text(include_str!("../wgsl/each_tap.wgsl"))
}

/// What the position of an element in its group's list is multiplied with to give its bits: bit 0
/// flips x and bit 1 flips y.
fn flips(group: Group) -> usize {
    group.elements().get(1).map_or(0, |second| second.bits())
}

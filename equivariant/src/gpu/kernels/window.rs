//! Sliding windows in GPU kernels.

use symmetry::Group;

use crate::gpu::step::KernelStep;
use crate::shape::Shape;
use crate::window::SlidingWindow;

/// Adds the WGSL functions on sliding windows, `window.wgsl`, and their constants to a kernel.
pub(super) fn windows(
    step: KernelStep,
    kernel: SlidingWindow,
    [from, to]: [Shape; 2],
) -> KernelStep {
    let step = step.add_u32_constants([
        ("SIZE", kernel.size),
        ("STRIDE", kernel.stride),
        ("PADDING", kernel.padding),
        ("HEIGHT", from.height),
        ("WIDTH", from.width),
        ("OUT_PIXELS", to.num_pixels()),
        ("OUT_WIDTH", to.width),
        ("FLIPS", flips(from.fields.group())),
    ]);
    step.add_wgsl(include_str!("../wgsl/window.wgsl"))
}

/// Adds a sum over the taps of a window to a kernel that runs for each field. `at_tap` is
/// `pixel_at`, for the pixels in a window, or `window_at`, for the windows that contain a pixel.
pub(super) fn sum_over_taps(step: KernelStep, at_tap: &str) -> KernelStep {
    let head = "fn at_tap(place: u32, tap: vec2<u32>) -> i32";
    step.add_wgsl(&format!("{head} {{ return {at_tap}(place, tap); }}"))
        .add_wgsl(include_str!("../wgsl/each_tap.wgsl"))
}

/// Returns the factor from the position of a group element in its group's list to the element's
/// bits: bit 0 flips x and bit 1 flips y.
fn flips(group: Group) -> usize {
    group.elements().get(1).map_or(0, |second| second.bits())
}

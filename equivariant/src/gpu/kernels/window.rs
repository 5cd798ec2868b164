//! Sliding windows in GPU kernels.

use symmetry::Group;

use crate::gpu::kernel_dispatch::KernelDispatch;
use crate::shape::Shape;
use crate::window::SlidingWindow;

/// Adds the WGSL functions on sliding windows, `window.wgsl`, and their constants to a kernel.
pub(super) fn windows(
    kernel: KernelDispatch,
    window: SlidingWindow,
    [from, to]: [Shape; 2],
) -> KernelDispatch {
    let kernel = kernel.add_u32_constants([
        ("SIZE", window.size),
        ("STRIDE", window.stride),
        ("PADDING", window.padding),
        ("HEIGHT", from.height),
        ("WIDTH", from.width),
        ("OUT_PIXELS", to.num_pixels()),
        ("OUT_WIDTH", to.width),
        ("FLIPS", element_bits_per_index(from.fields.group())),
    ]);
    kernel.add_wgsl(include_str!("../wgsl/window.wgsl"))
}

/// Adds a sum over the taps of a window to a kernel that runs for each field. `at_tap` is
/// `pixel_at`, for the pixels in a window, or `window_at`, for the windows that contain a pixel.
pub(super) fn sum_over_taps(kernel: KernelDispatch, at_tap: &str) -> KernelDispatch {
    let head = "fn at_tap(place: u32, tap: vec2<u32>) -> i32";
    kernel
        .add_wgsl(&format!("{head} {{ return {at_tap}(place, tap); }}"))
        .add_wgsl(include_str!("../wgsl/each_tap.wgsl"))
}

/// Returns the factor by which the index of a group element in its group's list is multiplied to
/// get the element's bits: bit 0 flips x and bit 1 flips y.
fn element_bits_per_index(group: Group) -> usize {
    group.elements().get(1).map_or(0, |second| second.bits())
}

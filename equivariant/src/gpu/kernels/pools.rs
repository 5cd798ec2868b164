//! GPU kernels of pooling over sliding windows.

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::BufferSlot;
use crate::gpu::kernels::pointwise::{Map, gradients, kernel_per_field, passes, permuted_channels};
use crate::gpu::kernels::window::{sum_over_taps, windows};
use crate::gpu::plan::{Plan, Tensor};
use crate::window::SlidingWindow;

/// Adds the GPU kernels of a max-pooling over sliding windows from map `x` to map `y`.
pub(super) fn max_pool(plan: &mut Plan, window: SlidingWindow, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let kernel = |label, pixels| {
        let kernel = kernel_per_field(label, &channels, pixels);
        windows(kernel, window, [x.shape, y.shape])
    };
    let forward =
        kernel("max-pool", y.shape.num_pixels()).add_wgsl(include_str!("../wgsl/max_pool.wgsl"));
    let backward = kernel("max-pool backward", x.shape.num_pixels());
    let backward = sum_over_taps(backward, "window_at");
    let backward = backward.add_wgsl(include_str!("../wgsl/max_pool_backward.wgsl"));
    passes(plan, Map::new(x, &channels), Map::new(y, &channels), [forward, backward]);
}

/// Adds the GPU kernels of an average-pooling over sliding windows, which treats channels of any
/// type separately.
pub(super) fn average_pool(plan: &mut Plan, window: SlidingWindow, x: &Tensor, y: &Tensor) {
    let channels = ChannelLayout::single_channel_fields(x.shape.fields.dim());
    let weight = (window.size as f64).powi(2).recip();
    let kernel = |(label, at_tap), pixels, [from, to]: [BufferSlot; 2]| {
        let kernel = kernel_per_field(label, &channels, pixels).add_f32_constant("SCALE", weight);
        let kernel = sum_over_taps(windows(kernel, window, [x.shape, y.shape]), at_tap);
        let kernel =
            channels.add_output_map(channels.add_input_map(kernel, "source", from), "sum", to);
        kernel.add_wgsl(include_str!("../wgsl/average_pool.wgsl"))
    };
    let [forward, backward] =
        [("average-pool", "pixel_at"), ("average-pool backward", "window_at")];
    // the gradient is an average as well: over the windows that contain a pixel
    let back = |[dx, dy]: [BufferSlot; 2]| kernel(backward, x.shape.num_pixels(), [dy, dx]);
    plan.add_kernels(
        vec![kernel(forward, y.shape.num_pixels(), [x.values, y.values])],
        gradients(x, y).map(back).into_iter().collect(),
    );
}

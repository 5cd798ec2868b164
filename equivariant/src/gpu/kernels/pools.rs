//! GPU kernels of pooling over sliding windows.

use crate::gpu::kernels::pointwise::{Map, kernel_per_field, passes, permuted_channels};
use crate::gpu::kernels::window::{sum_over_taps, windows};
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap};
use crate::window::SlidingWindow;

/// Adds the GPU kernels of a max-pooling over sliding windows from map `x` to map `y`.
pub(super) fn max_pool(
    plan: &mut ComputePlan,
    window: SlidingWindow,
    x: &PlannedFeatureMap,
    y: &PlannedFeatureMap,
) {
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

//! GPU kernels of layers that treat every field of every pixel separately.

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::{BufferSlot, KernelDispatch, WorkgroupCount};
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap};
use crate::steerable::hadamard::permuted_field_order_and_count;

/// Returns a GPU kernel, still without buffers and operation, that runs one thread per pixel and
/// field of a feature map.
pub(super) fn kernel_per_field(
    label: &'static str,
    channels: &ChannelLayout,
    pixels: usize,
) -> KernelDispatch {
    KernelDispatch::new(
        label,
        channels.components_per_field(),
        WorkgroupCount::for_threads_per_sample(pixels * channels.num_fields()),
    )
    .add_u32_constants([("PIXELS", pixels), ("FIELDS", channels.num_fields())])
    .add_wgsl(include_str!("../wgsl/each_field.wgsl"))
}

/// Returns the channel layout of a map's fields in the regular basis, whose components the group
/// permutes; other fields keep the layout of the irrep basis.
pub(super) fn permuted_channels(x: &PlannedFeatureMap) -> ChannelLayout {
    let fields = x.shape.fields;
    match permuted_field_order_and_count(fields) {
        Some((order, n)) => ChannelLayout::for_regular_fields(order, n),
        None => ChannelLayout::for_type(fields),
    }
}

/// Feature map of a batch on a GPU with the channel layout of its fields.
#[derive(Clone, Copy)]
pub(super) struct Map<'a> {
    tensor: &'a PlannedFeatureMap,
    channels: &'a ChannelLayout,
}

impl<'a> Map<'a> {
    pub fn new(tensor: &'a PlannedFeatureMap, channels: &'a ChannelLayout) -> Map<'a> {
        Map { tensor, channels }
    }
}

/// Adds the forward and the backward kernel of a layer without parameters. The first computes y
/// from x, the second the gradient with respect to x from x and the gradient with respect to y.
pub(super) fn passes(plan: &mut ComputePlan, x: Map, y: Map, kernels: [KernelDispatch; 2]) {
    let [forward, backward] =
        kernels.map(|kernel| x.channels.add_input_to_kernel(kernel, "x", x.tensor.values));
    let forward = y.channels.add_output_to_kernel(forward, "y", y.tensor.values);
    let backward = gradients(x.tensor, y.tensor).map(|[dx, dy]| {
        x.channels.add_output_to_kernel(
            y.channels.add_input_to_kernel(backward, "dy", dy),
            "dx",
            dx,
        )
    });
    plan.add_kernels(vec![forward], backward.into_iter().collect());
}

/// Adds the GPU kernels of a ReLU from map `x` to map `y`.
pub(super) fn relu(plan: &mut ComputePlan, x: &PlannedFeatureMap, y: &PlannedFeatureMap) {
    let channels = permuted_channels(x);
    let texts = [
        ("relu", include_str!("../wgsl/relu.wgsl")),
        ("relu backward", include_str!("../wgsl/relu_backward.wgsl")),
    ];
    let kernels = texts.map(|(label, text)| {
        kernel_per_field(label, &channels, x.shape.num_pixels()).add_wgsl(text)
    });
    passes(plan, Map::new(x, &channels), Map::new(y, &channels), kernels);
}

/// Adds the GPU kernels of a maximum over the group from map `x` to map `y`.
pub(super) fn group_max_pool(plan: &mut ComputePlan, x: &PlannedFeatureMap, y: &PlannedFeatureMap) {
    let [of_x, of_y] = [x, y].map(|map| ChannelLayout::for_type(map.shape.fields));
    let texts = [
        ("group max-pool", include_str!("../wgsl/group_max_pool.wgsl")),
        ("group max-pool backward", include_str!("../wgsl/group_max_pool_backward.wgsl")),
    ];
    let kernels = texts
        .map(|(label, text)| kernel_per_field(label, &of_x, x.shape.num_pixels()).add_wgsl(text));
    passes(plan, Map::new(x, &of_x), Map::new(y, &of_y), kernels);
}

/// Returns the buffers of the gradients with respect to `x` and `y` if both are needed.
fn gradients(x: &PlannedFeatureMap, y: &PlannedFeatureMap) -> Option<[BufferSlot; 2]> {
    Some([x.gradient?, y.gradient?])
}

//! GPU kernels for the points where networks branch and join.

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::{BufferSlot, KernelDispatch};
use crate::gpu::kernels::pointwise::kernel_per_field;
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap};

/// Adds the kernels that copy two feature maps into their direct sum, and the gradients back.
pub(super) fn concat(
    plan: &mut ComputePlan,
    inputs: &[PlannedFeatureMap; 2],
    y: &PlannedFeatureMap,
) {
    let pixels = y.shape.num_pixels();
    let [first, second] =
        inputs.each_ref().map(|input| ChannelLayout::for_type(input.shape.fields));
    let sum = ChannelLayout::for_type(y.shape.fields);
    let places = [first.as_first_summand(&sum), second.as_second_summand(&sum)];
    let mut steps = [Vec::new(), Vec::new()];
    for ((input, place), own) in inputs.iter().zip(places).zip([first, second]) {
        steps[0].push(copy(&own, input.values, &place, y.values, pixels));
        if let (Some(to), Some(from)) = (input.gradient, y.gradient) {
            steps[1].push(copy(&place, from, &own, to, pixels));
        }
    }
    let [forward, backward] = steps;
    plan.add_kernels(forward, backward);
}

/// Returns a GPU kernel that copies the fields of a map from one channel layout to another.
fn copy(
    from: &ChannelLayout,
    x: BufferSlot,
    to: &ChannelLayout,
    y: BufferSlot,
    pixels: usize,
) -> KernelDispatch {
    let kernel = kernel_per_field("copy", from, pixels);
    let kernel = to.add_output_to_kernel(from.add_input_to_kernel(kernel, "x", x), "y", y);
    kernel.add_wgsl(include_str!("../wgsl/copy.wgsl"))
}

/// Adds the kernel that sums the gradients of a feature map from both layers that read it.
pub(super) fn fork(
    plan: &mut ComputePlan,
    x: &PlannedFeatureMap,
    readers: &[PlannedFeatureMap; 2],
) {
    let [first, second] = readers.each_ref().map(|reader| reader.gradient);
    let (Some(first), Some(second), Some(dx)) = (first, second, x.gradient) else {
        return;
    };
    let channels = ChannelLayout::for_single_channel_fields(x.shape.fields.dim());
    let kernel = kernel_per_field("add", &channels, x.shape.num_pixels());
    let kernel =
        channels.add_input_to_kernel(channels.add_input_to_kernel(kernel, "a", first), "b", second);
    let kernel = channels.add_output_to_kernel(kernel, "y", dx);
    plan.add_kernels(Vec::new(), vec![kernel.add_wgsl(include_str!("../wgsl/add.wgsl"))]);
}

//! GPU kernel that sums partial parameter gradients.

use std::ops::Range;

use crate::gpu::kernel_dispatch::{BufferSlot, DynamicDim, KernelDispatch, WorkgroupCount};
use crate::gpu::kernels::product::dim_function;
use crate::gpu::plan::ComputePlan;

/// Returns the GPU kernel that sums the gradients of the parameters `params` over the `parts` parts
/// of the batch.
pub(super) fn sum_partial_gradients(
    plan: &ComputePlan,
    partial: BufferSlot,
    parts: DynamicDim,
    params: Range<usize>,
) -> KernelDispatch {
    KernelDispatch::new("sum", 1, WorkgroupCount::for_fixed_threads(params.len()))
        .add_u32_constants([("BASE", params.start), ("LEN", params.len())])
        .add_wgsl(&dim_function("parts", parts))
        .add_input_buffer("partial", "f32", partial)
        .add_output_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_wgsl(include_str!("../wgsl/sum.wgsl"))
}

//! Sums of partial gradients.

use std::ops::Range;

use crate::gpu::kernels::product::row_count_function;
use crate::gpu::plan::Plan;
use crate::gpu::step::{BufferSlot, KernelStep, RowCount, WorkgroupCount};

/// Returns the kernel that adds up partial gradients of the parameters `params`.
pub(super) fn sum(
    plan: &Plan,
    partial: BufferSlot,
    parts: RowCount,
    params: Range<usize>,
) -> KernelStep {
    KernelStep::new("sum", 1, WorkgroupCount::fixed_threads(params.len()))
        .add_u32_constants([("BASE", params.start), ("LEN", params.len())])
        .add_wgsl(&row_count_function("parts", parts))
        .add_input_buffer("partial", "f32", partial)
        .add_output_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_wgsl(include_str!("../wgsl/sum.wgsl"))
}

//! Sums of partial gradients.

use std::ops::Range;

use crate::gpu::kernels::product::expression;
use crate::gpu::plan::Plan;
use crate::gpu::step::{Rows, Slot, Step, Work};

/// Returns the kernel that adds up partial gradients of the parameters `params`.
pub(super) fn sum(plan: &Plan, partial: Slot, parts: Rows, params: Range<usize>) -> Step {
    Step::new("sum", 1, Work::fixed_threads(params.len()))
        .constants([("BASE", params.start), ("LEN", params.len())])
        .text(&expression("parts", parts))
        .read("partial", "f32", partial)
        .write("gradient", "f32", plan.gradient())
        .text(include_str!("../wgsl/sum.wgsl"))
}

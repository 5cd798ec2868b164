//! Sums of partial gradients.

use crate::gpu::kernels::product::expression;
use crate::gpu::plan::Plan;
use crate::gpu::step::{Rows, Slot, Step, Work};

/// Adds up partial gradients in the `len` parameters from number `start` on.
pub(super) fn sum(plan: &Plan, partial: Slot, parts: Rows, (start, len): (usize, usize)) -> Step {
    Step::new("sum", 1, Work::fixed_threads(len))
        .constants([("BASE", start), ("LEN", len)])
        .text(&expression("parts", parts))
        .read("partial", "f32", partial)
        .write("gradient", "f32", plan.gradient())
        .text(include_str!("../wgsl/sum.wgsl"))
}

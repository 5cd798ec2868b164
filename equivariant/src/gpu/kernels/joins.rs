//! Kernels for the points where networks branch and join.

use crate::gpu::channels::Channels;
use crate::gpu::kernels::pointwise::each_field;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::{Slot, Step};

/// Adds the kernels that copy both maps into their direct sum, and the gradients back.
pub(super) fn concat(plan: &mut Plan, inputs: &[Tensor; 2], y: &Tensor) {
    let pixels = y.shape.pixels();
    let [first, second] = inputs.each_ref().map(|input| Channels::of(input.shape.fields));
    let sum = Channels::of(y.shape.fields);
    let places = [first.at_start_of(&sum), second.at_end_of(&sum)];
    let mut steps = [Vec::new(), Vec::new()];
    for ((input, place), own) in inputs.iter().zip(places).zip([first, second]) {
        steps[0].push(copy(&own, input.values, &place, y.values, pixels));
        if let (Some(to), Some(from)) = (input.gradient, y.gradient) {
            steps[1].push(copy(&place, from, &own, to, pixels));
        }
    }
    let [forward, backward] = steps;
    plan.push(forward, backward);
}

/// Returns a kernel that copies fields from one layout to another.
fn copy(from: &Channels, x: Slot, to: &Channels, y: Slot, pixels: usize) -> Step {
    let step = each_field("copy", from, pixels);
    let step = to.write(from.read(step, "x", x), "y", y);
    step.text(include_str!("../wgsl/copy.wgsl"))
}

/// Adds the kernel that sums the gradients of both consumers of a map.
pub(super) fn fork(plan: &mut Plan, x: &Tensor, readers: &[Tensor; 2]) {
    let [first, second] = readers.each_ref().map(|reader| reader.gradient);
    let (Some(first), Some(second), Some(dx)) = (first, second, x.gradient) else {
        return;
    };
    let channels = Channels::single(x.shape.fields.dim());
    let step = each_field("add", &channels, x.shape.pixels());
    let step = channels.read(channels.read(step, "a", first), "b", second);
    let step = channels.write(step, "y", dx);
    plan.push(Vec::new(), vec![step.text(include_str!("../wgsl/add.wgsl"))]);
}

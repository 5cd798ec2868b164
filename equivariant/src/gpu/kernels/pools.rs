//! Pooling over windows.

use crate::gpu::channels::Channels;
use crate::gpu::kernels::pointwise::{each_field, gradients, permuted_channels};
use crate::gpu::kernels::window::windows;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::Step;
use crate::window::Kernel;

pub(super) fn max_pool(plan: &mut Plan, kernel: Kernel, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let step = |label, pixels| {
        let step = each_field(label, &channels, pixels);
        let step = windows(step, kernel, [x.shape, y.shape]);
        channels.read(step, "x", x.values)
    };
    let forward = channels.write(step("max-pool", y.shape.pixels()), "y", y.values);
    let forward = forward.text(include_str!("../wgsl/max_pool.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let step = step("max-pool backward", x.shape.pixels());
        let step = channels.write(channels.read(step, "dy", dy), "dx", dx);
        step.text(include_str!("../wgsl/max_pool_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

/// Channel by channel, whatever the type.
pub(super) fn average_pool(plan: &mut Plan, kernel: Kernel, x: &Tensor, y: &Tensor) {
    let channels = Channels::single(x.shape.fields.dim());
    let weight = (kernel.size as f64).powi(2).recip();
    let step = |label, pixels| -> Step {
        let step = each_field(label, &channels, pixels).number("SCALE", weight);
        windows(step, kernel, [x.shape, y.shape])
    };
    let forward = channels.read(step("average-pool", y.shape.pixels()), "x", x.values);
    let forward = channels.write(forward, "y", y.values);
    let forward = forward.text(include_str!("../wgsl/average_pool.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let step = step("average-pool backward", x.shape.pixels());
        let step = channels.write(channels.read(step, "dy", dy), "dx", dx);
        step.text(include_str!("../wgsl/average_pool_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

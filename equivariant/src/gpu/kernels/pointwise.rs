//! Layers that treat every field of every pixel apart from all others.

use crate::gpu::channels::Channels;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::{Slot, Step, Work};
use crate::steerable::hadamard::permuted;

/// A kernel with a thread for each pixel and field of a map.
pub(super) fn each_field(label: &'static str, channels: &Channels, pixels: usize) -> Step {
    Step::new(
        label,
        channels.order(),
        Work::threads(pixels * channels.fields()),
    )
    .constants([("PIXELS", pixels), ("FIELDS", channels.fields())])
    .text(include_str!("../wgsl/each_field.wgsl"))
}

/// The fields of a map that the group permutes in the regular basis.
pub(super) fn permuted_channels(x: &Tensor) -> Channels {
    let fields = x.shape.fields;
    match permuted(fields) {
        Some((order, n)) => Channels::regular(order, n),
        None => Channels::of(fields),
    }
}

pub(super) fn relu(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let kernel = |label| each_field(label, &channels, x.shape.pixels());
    let step = channels.read(kernel("relu"), "x", x.values);
    let step = channels.write(step, "y", y.values);
    let forward = step.text(include_str!("../wgsl/relu.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let step = channels.read(kernel("relu backward"), "x", x.values);
        let step = channels.write(channels.read(step, "dy", dy), "dx", dx);
        step.text(include_str!("../wgsl/relu_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

pub(super) fn group_max_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let channels = Channels::of(x.shape.fields);
    let kernel = |label| {
        let step = each_field(label, &channels, x.shape.pixels());
        channels.read(step, "x", x.values)
    };
    let step = kernel("group max-pool").write("y", "f32", y.values);
    let forward = step.text(include_str!("../wgsl/group_max_pool.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let step = kernel("group max-pool backward").read("dy", "f32", dy);
        let step = channels.write(step, "dx", dx);
        step.text(include_str!("../wgsl/group_max_pool_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

pub(super) fn group_mean_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let channels = Channels::of(x.shape.fields);
    let scale = (channels.order() as f64).sqrt().recip();
    let kernel = |label| each_field(label, &channels, x.shape.pixels()).number("SCALE", scale);
    let step = channels.read(kernel("group mean-pool"), "x", x.values);
    let step = step.write("y", "f32", y.values);
    let forward = step.text(include_str!("../wgsl/group_mean_pool.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let step = kernel("group mean-pool backward").read("dy", "f32", dy);
        let step = channels.write(step, "dx", dx);
        step.text(include_str!("../wgsl/group_mean_pool_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

/// The gradients in an input and an output, where both are wanted.
pub(super) fn gradients(x: &Tensor, y: &Tensor) -> Option<[Slot; 2]> {
    Some([x.gradient?, y.gradient?])
}

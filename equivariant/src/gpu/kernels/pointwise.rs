//! Layers that treat every field of every pixel apart from all others.

use crate::gpu::channels::Channels;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::{Slot, Step, Work};
use crate::steerable::hadamard::permuted;

/// A kernel with a thread for each pixel and field of a map.
pub(super) fn each_field(label: &'static str, channels: &Channels, pixels: usize) -> Step {
    Step::new(label, channels.order(), Work::threads(pixels * channels.fields()))
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

/// Adds the kernels of a layer: one that makes y of x, and one that makes the gradient in x of x
/// and of that in y. With each map goes where the numbers of its fields lie.
pub(super) fn passes(
    plan: &mut Plan,
    [(x, of_x), (y, of_y)]: [(&Tensor, &Channels); 2],
    kernels: [Step; 2],
) {
    let [forward, backward] = kernels.map(|step| of_x.read(step, "x", x.values));
    let forward = of_y.write(forward, "y", y.values);
    let backward =
        gradients(x, y).map(|[dx, dy]| of_x.write(of_y.read(backward, "dy", dy), "dx", dx));
    plan.push(vec![forward], backward.into_iter().collect());
}

pub(super) fn relu(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let texts = [
        ("relu", include_str!("../wgsl/relu.wgsl")),
        ("relu backward", include_str!("../wgsl/relu_backward.wgsl")),
    ];
    let kernels =
        texts.map(|(label, text)| each_field(label, &channels, x.shape.pixels()).text(text));
    passes(plan, [(x, &channels), (y, &channels)], kernels);
}

pub(super) fn group_max_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let backward = include_str!("../wgsl/group_max_pool_backward.wgsl");
    let texts = [
        ("group max-pool", include_str!("../wgsl/group_max_pool.wgsl")),
        ("group max-pool backward", backward),
    ];
    group_pool(plan, (x, y), texts, |step| step);
}

pub(super) fn group_mean_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let scale = (x.shape.fields.group().order() as f64).sqrt().recip();
    let backward = include_str!("../wgsl/group_mean_pool_backward.wgsl");
    let texts = [
        ("group mean-pool", include_str!("../wgsl/group_mean_pool.wgsl")),
        ("group mean-pool backward", backward),
    ];
    group_pool(plan, (x, y), texts, |step| step.number("SCALE", scale));
}
/// From fields of the regular basis to one number each, by kernels of these names and texts.
fn group_pool(
    plan: &mut Plan,
    (x, y): (&Tensor, &Tensor),
    texts: [(&'static str, &str); 2],
    constants: impl Fn(Step) -> Step,
) {
    let [of_x, of_y] = [x, y].map(|map| Channels::of(map.shape.fields));
    let kernels =
        texts.map(|(label, text)| constants(each_field(label, &of_x, x.shape.pixels()).text(text)));
    passes(plan, [(x, &of_x), (y, &of_y)], kernels);
}

/// The gradients in an input and an output, where both are wanted.
pub(super) fn gradients(x: &Tensor, y: &Tensor) -> Option<[Slot; 2]> {
    Some([x.gradient?, y.gradient?])
}

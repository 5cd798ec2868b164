//! Kernels of layers that treat every field of every pixel separately.

use crate::gpu::channels::Channels;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::{Slot, Step, Work};
use crate::steerable::hadamard::permuted;

/// Returns a kernel with a thread for each pixel and field of a map.
pub(super) fn each_field(label: &'static str, channels: &Channels, pixels: usize) -> Step {
    Step::new(label, channels.order(), Work::threads(pixels * channels.fields()))
        .constants([("PIXELS", pixels), ("FIELDS", channels.fields())])
        .text(include_str!("../wgsl/each_field.wgsl"))
}

/// Returns the layout of the fields that the group permutes in the regular basis.
pub(super) fn permuted_channels(x: &Tensor) -> Channels {
    let fields = x.shape.fields;
    match permuted(fields) {
        Some((order, n)) => Channels::regular(order, n),
        None => Channels::of(fields),
    }
}

/// Map of the batch with the layout of its fields.
#[derive(Clone, Copy)]
pub(super) struct Map<'a> {
    tensor: &'a Tensor,
    channels: &'a Channels,
}

impl<'a> Map<'a> {
    pub fn new(tensor: &'a Tensor, channels: &'a Channels) -> Map<'a> {
        Map { tensor, channels }
    }
}

/// Adds the kernels of a layer. The first computes y from x, the second the gradient with respect
/// to x from x and the gradient with respect to y.
pub(super) fn passes(plan: &mut Plan, x: Map, y: Map, kernels: [Step; 2]) {
    let [forward, backward] = kernels.map(|step| x.channels.read(step, "x", x.tensor.values));
    let forward = y.channels.write(forward, "y", y.tensor.values);
    let backward = gradients(x.tensor, y.tensor)
        .map(|[dx, dy]| x.channels.write(y.channels.read(backward, "dy", dy), "dx", dx));
    plan.push(vec![forward], backward.into_iter().collect());
}

/// Adds the kernels of a ReLU.
pub(super) fn relu(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let texts = [
        ("relu", include_str!("../wgsl/relu.wgsl")),
        ("relu backward", include_str!("../wgsl/relu_backward.wgsl")),
    ];
    let kernels =
        texts.map(|(label, text)| each_field(label, &channels, x.shape.pixels()).text(text));
    passes(plan, Map::new(x, &channels), Map::new(y, &channels), kernels);
}

/// Adds the kernels of a group max-pooling.
pub(super) fn group_max_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let backward = include_str!("../wgsl/group_max_pool_backward.wgsl");
    let texts = [
        ("group max-pool", include_str!("../wgsl/group_max_pool.wgsl")),
        ("group max-pool backward", backward),
    ];
    group_pool(plan, x, y, texts, |step| step);
}

/// Adds the kernels of a group mean-pooling.
pub(super) fn group_mean_pool(plan: &mut Plan, x: &Tensor, y: &Tensor) {
    let scale = (x.shape.fields.group().order() as f64).sqrt().recip();
    let backward = include_str!("../wgsl/group_mean_pool_backward.wgsl");
    let texts = [
        ("group mean-pool", include_str!("../wgsl/group_mean_pool.wgsl")),
        ("group mean-pool backward", backward),
    ];
    group_pool(plan, x, y, texts, |step| step.number("SCALE", scale));
}

/// Adds kernels with these names and texts that reduce each regular field to one number.
fn group_pool(
    plan: &mut Plan,
    x: &Tensor,
    y: &Tensor,
    texts: [(&'static str, &str); 2],
    constants: impl Fn(Step) -> Step,
) {
    let [of_x, of_y] = [x, y].map(|map| Channels::of(map.shape.fields));
    let kernels =
        texts.map(|(label, text)| constants(each_field(label, &of_x, x.shape.pixels()).text(text)));
    passes(plan, Map::new(x, &of_x), Map::new(y, &of_y), kernels);
}

/// Returns the gradients of input and output if both are needed.
pub(super) fn gradients(x: &Tensor, y: &Tensor) -> Option<[Slot; 2]> {
    Some([x.gradient?, y.gradient?])
}

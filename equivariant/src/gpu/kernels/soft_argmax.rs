//! Kernels of the spatial soft-argmax.

use symmetry::Irrep;

use crate::gpu::channels::Channels;
use crate::gpu::kernels::pointwise::{each_field, gradients, permuted_channels};
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::step::{Combine, Step, Work};

/// Adds the kernels of a soft-argmax from `x` to `y`.
pub(super) fn add(plan: &mut Plan, temperature: f64, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let keypoints = keypoints(&channels, x, y);
    let kept = plan.buffer(0, 4 * channels.order() * channels.fields());
    let common = |step: Step| {
        let step = step
            .number("SCALE", temperature.recip())
            .constants([("HEIGHT", x.shape.height), ("WIDTH", x.shape.width)]);
        let step = signs(step, &channels, x).text(include_str!("../wgsl/position.wgsl"));
        channels.read(step, "x", x.values)
    };
    let sizes = [("PIXELS", x.shape.pixels()), ("FIELDS", channels.fields())];
    let step = Step::new("soft-argmax", channels.order(), Work::groups(channels.fields()));
    let step = common(step.constants(sizes))
        .reduction("largest_of", "Field", Combine::Largest)
        .reduction("added", "Field", Combine::Sum)
        .write("kept", "Field", kept);
    let step = step.write("y", "f32", y.values);
    let step = keypoints
        .iter()
        .zip(["y_x", "y_y"])
        .fold(step, |step, (to, name)| to.add_store_function(step, "y", name));
    let forward = step.text(include_str!("../wgsl/soft_argmax.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let backward_step = common(each_field("soft-argmax backward", &channels, x.shape.pixels()));
        let backward_step = backward_step.read("kept", "Field", kept).read("dy", "f32", dy);
        let backward_step = keypoints
            .iter()
            .zip(["dy_x", "dy_y"])
            .fold(backward_step, |backward_step, (from, name)| {
                from.loader(backward_step, "dy", name)
            });
        let backward_step = channels.write(backward_step, "dx", dx);
        backward_step.text(include_str!("../wgsl/soft_argmax_backward.wgsl"))
    });
    plan.push(vec![forward], backward.into_iter().collect());
}

/// Returns the layouts of the fields of x and of y in the output.
fn keypoints(channels: &Channels, x: &Tensor, y: &Tensor) -> [Channels; 2] {
    let (n, order, to) = (channels.fields(), channels.order(), y.shape.fields);
    let group = x.shape.fields.group();
    let at = |starts| channels.clone().within(to.dim(), starts);
    if order > 1 {
        let starts = |skipped| (0..order).map(|a| 2 * n * a + skipped).collect();
        return [at(starts(0)), at(starts(n))];
    }
    // under C1 and C2, x and y are the same irrep, and x comes first
    let range = |irrep| to.range(group.restrict(irrep));
    [at(vec![range(Irrep::X).start]), at(vec![range(Irrep::Y).end - n])]
}

/// Adds the signs by which the group's elements flip x and y.
fn signs(step: Step, channels: &Channels, x: &Tensor) -> Step {
    let elements = x.shape.fields.group().elements();
    let named = [("SIGNS_X", Irrep::X), ("SIGNS_Y", Irrep::Y)];
    named.into_iter().fold(step, |step, (name, irrep)| {
        let signs = elements[..channels.order()].iter().map(|&g| format!("{}.0", irrep.sign(g)));
        let signs: Vec<String> = signs.collect();
        step.text(&format!("const {name} = Field({});", signs.join(", ")))
    })
}

//! GPU kernels of the spatial soft-argmax.

use symmetry::Irrep;

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::{KernelDispatch, ReductionOp, WorkgroupCount};
use crate::gpu::kernels::pointwise::{gradients, kernel_per_field, permuted_channels};
use crate::gpu::plan::{Plan, Tensor};

/// Adds the kernels of a spatial soft-argmax from map `x` to keypoints `y`.
pub(super) fn add(plan: &mut Plan, temperature: f64, x: &Tensor, y: &Tensor) {
    let channels = permuted_channels(x);
    let keypoints = keypoints(&channels, x, y);
    let kept = plan.add_buffer(0, 4 * channels.components_per_field() * channels.num_fields());
    let common = |kernel: KernelDispatch| {
        let kernel = kernel
            .add_f32_constant("SCALE", temperature.recip())
            .add_u32_constants([("HEIGHT", x.shape.height), ("WIDTH", x.shape.width)]);
        let kernel = signs(kernel, &channels, x).add_wgsl(include_str!("../wgsl/position.wgsl"));
        channels.add_input_map(kernel, "x", x.values)
    };
    let sizes = [("PIXELS", x.shape.num_pixels()), ("FIELDS", channels.num_fields())];
    let kernel = KernelDispatch::new(
        "soft-argmax",
        channels.components_per_field(),
        WorkgroupCount::workgroups_per_sample(channels.num_fields()),
    );
    let kernel = common(kernel.add_u32_constants(sizes))
        .add_workgroup_reduction("largest_of", "Field", ReductionOp::Max)
        .add_workgroup_reduction("added", "Field", ReductionOp::Sum)
        .add_output_buffer("kept", "Field", kept);
    let kernel = kernel.add_output_buffer("y", "f32", y.values);
    let kernel = keypoints
        .iter()
        .zip(["y_x", "y_y"])
        .fold(kernel, |kernel, (to, name)| to.add_store_function(kernel, "y", name));
    let forward = kernel.add_wgsl(include_str!("../wgsl/soft_argmax.wgsl"));
    let backward = gradients(x, y).map(|[dx, dy]| {
        let backward_step =
            common(kernel_per_field("soft-argmax backward", &channels, x.shape.num_pixels()));
        let backward_step =
            backward_step.add_input_buffer("kept", "Field", kept).add_input_buffer("dy", "f32", dy);
        let backward_step = keypoints
            .iter()
            .zip(["dy_x", "dy_y"])
            .fold(backward_step, |backward_step, (from, name)| {
                from.add_load_function(backward_step, "dy", name)
            });
        let backward_step = channels.add_output_map(backward_step, "dx", dx);
        backward_step.add_wgsl(include_str!("../wgsl/soft_argmax_backward.wgsl"))
    });
    plan.add_kernels(vec![forward], backward.into_iter().collect());
}

/// Returns the channel layouts of the keypoints' x coordinates and of their y coordinates in the
/// output.
fn keypoints(channels: &ChannelLayout, x: &Tensor, y: &Tensor) -> [ChannelLayout; 2] {
    let (n, order, to) = (channels.num_fields(), channels.components_per_field(), y.shape.fields);
    let group = x.shape.fields.group();
    let at = |starts| channels.clone().moved_to(to.dim(), starts);
    if order > 1 {
        let starts = |skipped| (0..order).map(|a| 2 * n * a + skipped).collect();
        return [at(starts(0)), at(starts(n))];
    }
    // under C1 and C2, x and y are the same irrep, and x comes first
    let range = |irrep| to.channel_range(group.restrict_irrep(irrep));
    [at(vec![range(Irrep::X).start]), at(vec![range(Irrep::Y).end - n])]
}

/// Adds the signs by which the group's elements flip x and y to a kernel, as WGSL constants.
fn signs(kernel: KernelDispatch, channels: &ChannelLayout, x: &Tensor) -> KernelDispatch {
    let elements = x.shape.fields.group().elements();
    let named = [("SIGNS_X", Irrep::X), ("SIGNS_Y", Irrep::Y)];
    named.into_iter().fold(kernel, |kernel, (name, irrep)| {
        let signs = elements[..channels.components_per_field()]
            .iter()
            .map(|&g| format!("{}.0", irrep.sign(g)));
        let signs: Vec<String> = signs.collect();
        kernel.add_wgsl(&format!("const {name} = Field({});", signs.join(", ")))
    })
}

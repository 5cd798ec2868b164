//! GPU kernels of field normalisation.

use symmetry::Irrep;

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::{BufferSlot, DynamicDim, KernelDispatch, WorkgroupCount};
use crate::gpu::kernels::partial::sum_partial_gradients;
use crate::gpu::kernels::product::dim_function;
use crate::gpu::plan::{Plan, SharedBuffer, Tensor};
use crate::layers::field_norm::VARIANCE_EPSILON;
use crate::layers::layer::NormStatistics;

/// Field normalisation on a GPU with its buffers.
struct FieldNorm<'a> {
    moments: &'a NormStatistics,
    x: Tensor,
    channels: ChannelLayout,
    /// Number of fields with a mean and a bias.
    num_biases: usize,
    /// Index of the normalisation's first parameter in the GPU buffer.
    first_param: usize,
    /// Buffer of the mean and the reciprocal standard deviation of each field, for each part of the
    /// batch with its own statistics.
    statistics: BufferSlot,
}

/// Adds the kernels of a field normalisation from map `x` to map `y`.
pub(super) fn add(plan: &mut Plan, moments: &NormStatistics, x: &Tensor, y: &Tensor) {
    let fields = x.shape.fields;
    let channels = match fields.num_regular_fields() {
        Some(n) => ChannelLayout::regular_fields(fields.group().order(), n),
        None => ChannelLayout::single_channel_fields(fields.dim()),
    };
    let num_biases = fields.multiplicity(Irrep::Trivial);
    let len = channels.num_fields() + num_biases;
    let norm = FieldNorm {
        moments,
        x: *x,
        num_biases,
        first_param: plan.reserve_params(len, 0..len),
        statistics: match moments {
            NormStatistics::Batch => plan.add_buffer(2 * channels.num_fields(), 0),
            _ => plan.add_buffer(0, 2 * channels.num_fields()),
        },
        channels,
    };
    let forward = norm.forward(plan, y.values);
    // the backward kernel computes the parameters' gradient, too, so it needs a place for dx
    let dx = x.gradient.unwrap_or_else(|| plan.add_buffer(0, x.shape.len()));
    let backward = y.gradient.map(|dy| norm.backward(plan, [dx, dy], len));
    plan.add_kernels(vec![forward], backward.unwrap_or_default());
}

impl FieldNorm<'_> {
    /// Returns the number of parts of the batch that have their own mean and variance.
    fn num_statistics(&self) -> DynamicDim {
        match self.moments {
            NormStatistics::Batch => DynamicDim::Fixed(1),
            _ => DynamicDim::PerSample(1),
        }
    }

    fn kernel(&self, plan: &Plan, label: &'static str) -> KernelDispatch {
        let (fields, pixels) = (self.channels.num_fields(), self.x.shape.num_pixels());
        let (work, pixels) = match self.moments {
            NormStatistics::Batch => {
                (WorkgroupCount::fixed_workgroups(fields), DynamicDim::PerSample(pixels))
            }
            _ => (WorkgroupCount::workgroups_per_sample(fields), DynamicDim::Fixed(pixels)),
        };
        let kernel = KernelDispatch::new(label, self.channels.components_per_field(), work)
            .add_u32_constants([
                ("FIELDS", fields),
                ("CENTRED", self.num_biases),
                ("BASE", self.first_param),
            ])
            .add_wgsl(&dim_function("parts", self.num_statistics()))
            .add_wgsl(&dim_function("pixels", pixels))
            .add_input_buffer("params", "f32", plan.params_buffer())
            .add_wgsl(include_str!("../wgsl/each_part.wgsl"));
        self.channels.add_input_map(kernel, "x", self.x.values)
    }

    fn forward(&self, plan: &mut Plan, y: BufferSlot) -> KernelDispatch {
        let kernel = self.kernel(plan, "field norm");
        let kernel = self.channels.add_output_map(kernel, "y", y);
        let kernel = kernel.add_output_buffer("kept", "vec2<f32>", self.statistics);
        let kernel = match self.moments {
            NormStatistics::Fixed(moments) => kernel
                .add_input_buffer(
                    "standards",
                    "vec2<f32>",
                    plan.add_constant_table(fixed_statistics(moments)),
                )
                .add_wgsl(include_str!("../wgsl/fixed.wgsl")),
            _ => kernel
                .add_f32_constant("EPSILON", VARIANCE_EPSILON)
                .add_workgroup_sum()
                .add_wgsl(include_str!("../wgsl/measured.wgsl")),
        };
        kernel.add_wgsl(include_str!("../wgsl/field_norm.wgsl"))
    }

    fn backward(
        &self,
        plan: &mut Plan,
        [dx, dy]: [BufferSlot; 2],
        len: usize,
    ) -> Vec<KernelDispatch> {
        let partial = match self.num_statistics() {
            DynamicDim::Fixed(parts) => {
                plan.shared_buffer(SharedBuffer::PartialGradients, parts * len, 0)
            }
            DynamicDim::PerSample(parts) => {
                plan.shared_buffer(SharedBuffer::PartialGradients, 0, parts * len)
            }
        };
        // fixed statistics do not depend on the input, so no gradient flows through them
        let dependent = if matches!(self.moments, NormStatistics::Fixed(_)) { 0.0 } else { 1.0 };
        let kernel = self.kernel(plan, "field norm backward");
        let kernel = self.channels.add_input_map(kernel, "dy", dy);
        let kernel = self.channels.add_output_map(kernel, "dx", dx);
        let kernel = kernel
            .add_input_buffer("kept", "vec2<f32>", self.statistics)
            .add_output_buffer("partial", "f32", partial)
            .add_u32_constants([("LEN", len)])
            .add_f32_constant("DEPENDENT", dependent)
            .add_workgroup_sum()
            .add_wgsl(include_str!("../wgsl/field_norm_backward.wgsl"));
        vec![
            kernel,
            sum_partial_gradients(
                plan,
                partial,
                self.num_statistics(),
                self.first_param..self.first_param + len,
            ),
        ]
    }
}

/// Returns mean and reciprocal of the standard deviation of each field as bits of f32.
fn fixed_statistics(moments: &[[f64; 2]]) -> Vec<u32> {
    let standards = moments.iter().flat_map(|&[mean, variance]| {
        let inverse = (variance + VARIANCE_EPSILON).sqrt().recip();
        [mean, inverse].map(|number| (number as f32).to_bits())
    });
    standards.collect()
}

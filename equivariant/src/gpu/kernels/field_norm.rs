//! Kernels of field normalisation.

use symmetry::Irrep;

use crate::gpu::channels::Channels;
use crate::gpu::kernels::partial::sum;
use crate::gpu::kernels::product::expression;
use crate::gpu::plan::{Plan, Shared, Tensor};
use crate::gpu::step::{Rows, Slot, Step, Work};
use crate::layers::field_norm::EPSILON;
use crate::layers::layer::Statistics;

/// Normalisation with its buffers.
struct FieldNorm<'a> {
    moments: &'a Statistics,
    x: Tensor,
    channels: Channels,
    /// Number of fields with a mean and a bias.
    centred: usize,
    /// Index of the first parameter.
    base: usize,
    /// Mean and reciprocal of the standard deviation of each part and field.
    kept: Slot,
}

/// Adds the kernels of a normalisation from `x` to `y`.
pub(super) fn add(plan: &mut Plan, moments: &Statistics, x: &Tensor, y: &Tensor) {
    let fields = x.shape.fields;
    let channels = match fields.regular_fields() {
        Some(n) => Channels::regular(fields.group().order(), n),
        None => Channels::single(fields.dim()),
    };
    let centred = fields.multiplicity(Irrep::Trivial);
    let len = channels.fields() + centred;
    let norm = FieldNorm {
        moments,
        x: *x,
        centred,
        base: plan.reserve(len, 0..len),
        kept: match moments {
            Statistics::Batch => plan.buffer(2 * channels.fields(), 0),
            _ => plan.buffer(0, 2 * channels.fields()),
        },
        channels,
    };
    let forward = norm.forward(plan, y.values);
    // the backward kernel computes the parameters' gradient, too, so it needs a place for dx
    let dx = x.gradient.unwrap_or_else(|| plan.buffer(0, x.shape.len()));
    let backward = y.gradient.map(|dy| norm.backward(plan, [dx, dy], len));
    plan.push(vec![forward], backward.unwrap_or_default());
}

impl FieldNorm<'_> {
    /// Returns the number of parts of the batch that have their own statistics.
    fn parts(&self) -> Rows {
        match self.moments {
            Statistics::Batch => Rows::Fixed(1),
            _ => Rows::Each(1),
        }
    }

    fn kernel(&self, plan: &Plan, label: &'static str) -> Step {
        let (fields, pixels) = (self.channels.fields(), self.x.shape.pixels());
        let (work, pixels) = match self.moments {
            Statistics::Batch => (Work::fixed_groups(fields), Rows::Each(pixels)),
            _ => (Work::groups(fields), Rows::Fixed(pixels)),
        };
        let step = Step::new(label, self.channels.order(), work)
            .constants([("FIELDS", fields), ("CENTRED", self.centred), ("BASE", self.base)])
            .text(&expression("parts", self.parts()))
            .text(&expression("pixels", pixels))
            .read("params", "f32", plan.params())
            .text(include_str!("../wgsl/each_part.wgsl"));
        self.channels.read(step, "x", self.x.values)
    }

    fn forward(&self, plan: &mut Plan, y: Slot) -> Step {
        let step = self.kernel(plan, "field norm");
        let step = self.channels.write(step, "y", y);
        let step = step.write("kept", "vec2<f32>", self.kept);
        let step = match self.moments {
            Statistics::Fixed(moments) => step
                .read("standards", "vec2<f32>", plan.table(standards(moments)))
                .text(include_str!("../wgsl/fixed.wgsl")),
            _ => step.number("EPSILON", EPSILON).sums().text(include_str!("../wgsl/measured.wgsl")),
        };
        step.text(include_str!("../wgsl/field_norm.wgsl"))
    }

    fn backward(&self, plan: &mut Plan, [dx, dy]: [Slot; 2], len: usize) -> Vec<Step> {
        let partial = match self.parts() {
            Rows::Fixed(parts) => plan.shared(Shared::Partial, parts * len, 0),
            Rows::Each(parts) => plan.shared(Shared::Partial, 0, parts * len),
        };
        // fixed statistics do not depend on the input, so no gradient flows through them
        let dependent = if matches!(self.moments, Statistics::Fixed(_)) { 0.0 } else { 1.0 };
        let step = self.kernel(plan, "field norm backward");
        let step = self.channels.read(step, "dy", dy);
        let step = self.channels.write(step, "dx", dx);
        let step = step
            .read("kept", "vec2<f32>", self.kept)
            .write("partial", "f32", partial)
            .constants([("LEN", len)])
            .number("DEPENDENT", dependent)
            .sums()
            .text(include_str!("../wgsl/field_norm_backward.wgsl"));
        vec![step, sum(plan, partial, self.parts(), self.base..self.base + len)]
    }
}

/// Returns mean and reciprocal of the standard deviation of each field as bits of f32.
fn standards(moments: &[[f64; 2]]) -> Vec<u32> {
    let standards = moments.iter().flat_map(|&[mean, variance]| {
        let inverse = (variance + EPSILON).sqrt().recip();
        [mean, inverse].map(|number| (number as f32).to_bits())
    });
    standards.collect()
}

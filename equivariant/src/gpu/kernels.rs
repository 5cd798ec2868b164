//! The kernels of every kind of layer.

mod field_norm;
mod linear;
mod partial;
mod pointwise;
mod pools;
mod product;
mod soft_argmax;
mod window;

use crate::gpu::error::GpuError;
use crate::gpu::plan::{Plan, Tensor};
use crate::layers::layer::Layer;
use crate::steerable::operation::Operation;

/// Adds the kernels of a layer, or of those of a chain; returns the output.
pub(crate) fn add(plan: &mut Plan, layer: &dyn Layer<f32>, x: Tensor) -> Result<Tensor, GpuError> {
    if !layer.layers().is_empty() {
        let mut layers = layer.layers().iter();
        return layers.try_fold(x, |x, layer| add(plan, layer.as_ref(), x));
    }
    let operation = layer.operation().ok_or_else(|| GpuError::Layer {
        layer: layer.to_string(),
    })?;
    let y = plan.tensor(layer.out_shape());
    add_operation(plan, &operation, &x, &y);
    Ok(y)
}

fn add_operation(plan: &mut Plan, operation: &Operation, x: &Tensor, y: &Tensor) {
    match operation {
        Operation::Linear(dense) => linear::add(plan, dense, x, y),
        Operation::Relu => pointwise::relu(plan, x, y),
        Operation::GroupMaxPool => pointwise::group_max_pool(plan, x, y),
        Operation::GroupMeanPool => pointwise::group_mean_pool(plan, x, y),
        Operation::MaxPool(kernel) => pools::max_pool(plan, *kernel, x, y),
        Operation::AveragePool(kernel) => pools::average_pool(plan, *kernel, x, y),
        Operation::FieldNorm(moments) => field_norm::add(plan, *moments, x, y),
        Operation::SoftArgmax { temperature } => soft_argmax::add(plan, *temperature, x, y),
    }
}

//! The kernels of every kind of layer.

mod field_norm;
mod joins;
mod linear;
mod partial;
mod pointwise;
mod pools;
mod product;
mod soft_argmax;
mod window;

use crate::gpu::error::GpuError;
use crate::gpu::plan::{Plan, Tensor};
use crate::layers::concat::Concat;
use crate::layers::layer::Layer;
use crate::steerable::operation::Operation;

impl Plan {
    /// Adds a layer, or those of a chain; returns the output.
    ///
    /// # Errors
    /// [`GpuError::Layer`] for a layer of another crate.
    pub fn layer(&mut self, layer: &dyn Layer<f32>, x: Tensor) -> Result<Tensor, GpuError> {
        if !layer.layers().is_empty() {
            let mut layers = layer.layers().iter();
            return layers.try_fold(x, |x, layer| self.layer(layer.as_ref(), x));
        }
        let operation = layer.operation().ok_or_else(|| GpuError::Layer {
            layer: layer.to_string(),
        })?;
        let y = self.tensor(layer.out_shape());
        add_operation(self, &operation, &x, &y);
        Ok(y)
    }

    /// Adds the direct sum of two maps; returns it.
    pub fn concat(&mut self, concat: &Concat, inputs: [Tensor; 2]) -> Tensor {
        let y = self.tensor(concat.out_shape());
        joins::concat(self, &inputs, &y);
        y
    }

    /// A map for two readers: each sends back a gradient of its own, and they are added up.
    pub fn fork(&mut self, x: Tensor) -> [Tensor; 2] {
        let readers = [(); 2].map(|()| Tensor {
            gradient: x.gradient.map(|_| self.buffer(0, x.shape.len())),
            ..x
        });
        joins::fork(self, &x, &readers);
        readers
    }
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

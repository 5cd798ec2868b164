//! GPU kernels of every kind of layer.

mod folds;
mod joins;
mod linear;
mod partial;
mod pointwise;
mod pools;
mod product;
mod window;

use crate::gpu::error::GpuError;
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap};
use crate::layers::Concat;
use crate::layers::layer::{Layer, LayerKind};
use crate::shape::Shape;
use crate::steerable::hadamard::permuted_field_order_and_count;

impl ComputePlan {
    /// Adds a layer, or the layers of a chain, to the compute plan and returns the output map. A
    /// ReLU after a layer with weights is fused into that layer's kernels.
    ///
    /// # Errors
    /// [`GpuError::UnsupportedLayer`] for a layer without kernels: [`BranchSum`](crate::BranchSum),
    /// [`Restrict`](crate::Restrict) and layers of other crates.
    pub fn add_layer(
        &mut self,
        layer: &dyn Layer<f32>,
        x: PlannedFeatureMap,
    ) -> Result<PlannedFeatureMap, GpuError> {
        let mut leaves = flatten_layers(layer).into_iter().peekable();
        let mut x = x;
        while let Some(leaf) = leaves.next() {
            let y = self.add_tensor(leaf.out_shape());
            let with_relu = leaf.kind().as_ordinary_conv().is_some()
                && leaves.next_if(|next| is_fusable_relu(*next, y.shape)).is_some();
            add(self, leaf, &x, &y, with_relu)?;
            x = y;
        }
        Ok(x)
    }

    /// Adds the direct sum of two feature maps to the compute plan and returns the sum.
    pub fn add_concat(
        &mut self,
        concat: &Concat,
        inputs: [PlannedFeatureMap; 2],
    ) -> PlannedFeatureMap {
        let y = self.add_tensor(concat.out_shape());
        joins::concat(self, &inputs, &y);
        y
    }

    /// Returns two handles to a feature map of the compute plan, for two layers that read it. Both
    /// share its values, each has its own gradient, and the backward pass adds the two gradients.
    pub fn add_fork(&mut self, x: PlannedFeatureMap) -> [PlannedFeatureMap; 2] {
        let readers = [(); 2].map(|()| PlannedFeatureMap {
            gradient: x.gradient.map(|_| self.add_buffer(0, x.shape.len())),
            ..x
        });
        joins::fork(self, &x, &readers);
        readers
    }
}

/// Returns the layers of a chain, including those of nested chains; any other layer is returned
/// alone.
fn flatten_layers(layer: &dyn Layer<f32>) -> Vec<&dyn Layer<f32>> {
    match layer.kind() {
        LayerKind::Sequential(layers) => {
            layers.iter().flat_map(|child| flatten_layers(child.as_ref())).collect()
        }
        _ => vec![layer],
    }
}

/// Returns `true` for a ReLU that can be fused with the layer before: one on fields with a
/// component for each group element.
fn is_fusable_relu(layer: &dyn Layer<f32>, shape: Shape) -> bool {
    let whole = permuted_field_order_and_count(shape.fields)
        .is_some_and(|(order, _)| order == shape.fields.group().order());
    whole && matches!(layer.kind(), LayerKind::Relu)
}

/// Adds the kernels of one layer from map `x` to map `y` to a compute plan, with a ReLU after it if
/// `with_relu`.
fn add(
    plan: &mut ComputePlan,
    layer: &dyn Layer<f32>,
    x: &PlannedFeatureMap,
    y: &PlannedFeatureMap,
    with_relu: bool,
) -> Result<(), GpuError> {
    match layer.kind() {
        LayerKind::R2Conv(conv) => linear::add(plan, &conv.as_ordinary_conv(), x, y, with_relu),
        LayerKind::Linear(dense) => linear::add(plan, &dense, x, y, with_relu),
        LayerKind::Relu => pointwise::relu(plan, x, y),
        LayerKind::GroupMaxPool => pointwise::group_max_pool(plan, x, y),
        LayerKind::MaxPool(kernel) => pools::max_pool(plan, kernel, x, y),
        LayerKind::Sequential(_) | LayerKind::Other => {
            return Err(GpuError::UnsupportedLayer { layer: layer.to_string() });
        }
    }
    Ok(())
}

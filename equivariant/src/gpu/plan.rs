//! Compute plans: buffers and kernels of a network as data, before any GPU is involved.

use std::collections::HashSet;

use crate::gpu::adapter::GpuAdapterInfo;
use crate::gpu::error::GpuError;
use crate::gpu::kernel_dispatch::{BufferSlot, KernelDispatch};
use crate::shape::Shape;

/// Alignment of a layer's parameters in the GPU buffer, in 32-bit words, as WGSL vectors need it.
const ALIGNMENT: usize = 4;
/// Number of bytes of a 32-bit word.
const BYTES_PER_WORD: usize = 4;

/// Length of a GPU buffer in 32-bit words: `fixed_len` plus `len_per_sample` for every sample.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BufferLength {
    pub fixed_len: usize,
    pub len_per_sample: usize,
}

impl BufferLength {
    /// Returns the size of the buffer in bytes for a batch of `samples` samples.
    pub fn bytes(self, samples: usize) -> u64 {
        let of_samples = (self.len_per_sample as u64).saturating_mul(samples as u64);
        let words = of_samples.saturating_add(self.fixed_len as u64);
        // buffers of no bytes cannot be bound; saturation makes overflows exceed every limit
        words.max(ALIGNMENT as u64).saturating_mul(BYTES_PER_WORD as u64)
    }
}

/// Feature map of a [`ComputePlan`]: its shape, and the slots of the buffers of its values and, if
/// it is needed, of its gradient.
#[derive(Clone, Copy, Debug)]
pub struct PlannedFeatureMap {
    /// Shape of one sample of the tensor.
    pub shape: Shape,
    /// Buffer of the map's values, `[N, H, W, C]` (samples, height, width, channels).
    pub values: BufferSlot,
    /// Buffer of the gradient with respect to the map's values, in their layout; `None` if the
    /// gradient is not needed.
    pub gradient: Option<BufferSlot>,
}

/// GPU buffer for temporary values that layers use in turn: no layer relies on another's contents.
#[derive(Clone, Copy, Debug)]
pub(crate) enum SharedBuffer {
    /// Buffer of the gradient with respect to the folded im2col patches of a convolution.
    FoldedGradient,
    /// Buffer of the parameter gradients of a layer over parts of the batch, before they are
    /// summed.
    PartialGradients,
}

/// Compute plan of a GPU: the buffers and kernels of networks that run together, from which a
/// [`CompiledPlan`](crate::gpu::CompiledPlan) is compiled.
///
/// Layers are added one after the other. Parameters are stored in the order of the kernels, with
/// zeros where a WGSL vector has no parameter;
/// [`params_to_device_order`](ComputePlan::params_to_device_order) converts parameters of the CPU
/// to this order and [`params_from_device_order`](ComputePlan::params_from_device_order) converts
/// them back.
#[derive(Debug)]
pub struct ComputePlan {
    /// Lengths of all GPU buffers, by slot.
    pub(crate) buffer_lengths: Vec<BufferLength>,
    /// Buffers of constants with their contents.
    pub(crate) constant_tables: Vec<(BufferSlot, Vec<u32>)>,
    /// Kernels of the forward pass, in order.
    pub(crate) forward: Vec<KernelDispatch>,
    /// Kernels of each layer's backward pass; the layers are in the order of the forward pass.
    backward: Vec<Vec<KernelDispatch>>,
    final_kernels: Vec<KernelDispatch>,
    param_positions: Vec<u32>,
}

const PARAMS: BufferSlot = BufferSlot(0);
const GRADIENT: BufferSlot = BufferSlot(1);
/// Slot of the GPU buffer [`SharedBuffer::FoldedGradient`].
const FOLDED: BufferSlot = BufferSlot(2);
/// Slot of the GPU buffer [`SharedBuffer::PartialGradients`].
const PARTIAL: BufferSlot = BufferSlot(3);

impl Default for ComputePlan {
    fn default() -> ComputePlan {
        ComputePlan::new()
    }
}

impl ComputePlan {
    /// Creates a compute plan without layers.
    pub fn new() -> ComputePlan {
        ComputePlan {
            buffer_lengths: vec![BufferLength::default(); 4],
            constant_tables: Vec::new(),
            forward: Vec::new(),
            backward: Vec::new(),
            final_kernels: Vec::new(),
            param_positions: Vec::new(),
        }
    }

    /// Returns the buffer of the parameters of all layers, in the order of the kernels.
    pub fn params_buffer(&self) -> BufferSlot {
        PARAMS
    }

    /// Returns the buffer of the gradient with respect to the parameters of all layers.
    pub fn params_gradient_buffer(&self) -> BufferSlot {
        GRADIENT
    }

    /// Returns the number of parameters of all layers, without padding.
    pub fn num_params(&self) -> usize {
        self.param_positions.len()
    }

    /// Returns two numbers of GPU kernels: those of the forward pass, and those of the backward
    /// pass with the ones that run after it.
    pub fn num_kernels_per_pass(&self) -> [usize; 2] {
        [self.forward.len(), self.backward_kernels().count()]
    }

    /// Returns the number of parameters on the GPU, with padding.
    pub fn num_device_params(&self) -> usize {
        self.buffer_lengths[PARAMS.0].fixed_len
    }

    /// Converts parameters from the order of the layers to the order of the kernels.
    ///
    /// # Panics
    /// When there are more or fewer than [`num_params`](ComputePlan::num_params).
    pub fn params_to_device_order(&self, params: &[f32]) -> Vec<f32> {
        let (got, expected) = (params.len(), self.num_params());
        assert!(got == expected, "got {got} parameters, expected {expected}");
        let mut on_device = vec![0.0; self.num_device_params()];
        for (&position, &param) in self.param_positions.iter().zip(params) {
            on_device[position as usize] = param;
        }
        on_device
    }

    /// Converts parameters from the order of the kernels to the order of the layers, the reverse of
    /// [`params_to_device_order`](ComputePlan::params_to_device_order).
    ///
    /// # Panics
    /// When there are fewer than [`num_device_params`](ComputePlan::num_device_params).
    pub fn params_from_device_order(&self, on_device: &[f32]) -> Vec<f32> {
        self.param_positions.iter().map(|&position| on_device[position as usize]).collect()
    }

    /// Adds a GPU buffer of `fixed` 32-bit words, and `each` more for every sample, to the compute
    /// plan.
    pub fn add_buffer(&mut self, fixed: usize, each: usize) -> BufferSlot {
        self.buffer_lengths.push(BufferLength { fixed_len: fixed, len_per_sample: each });
        BufferSlot(self.buffer_lengths.len() - 1)
    }

    /// Adds a GPU buffer of the constants `words` to the compute plan.
    pub fn add_constant_table(&mut self, words: Vec<u32>) -> BufferSlot {
        let slot = self.add_buffer(words.len(), 0);
        self.constant_tables.push((slot, words));
        slot
    }

    /// Adds a feature map without a gradient to the compute plan, as an input.
    pub fn add_input(&mut self, shape: Shape) -> PlannedFeatureMap {
        PlannedFeatureMap { shape, values: self.add_buffer(0, shape.len()), gradient: None }
    }

    /// Adds a feature map with its gradient to the compute plan.
    pub fn add_tensor(&mut self, shape: Shape) -> PlannedFeatureMap {
        PlannedFeatureMap {
            gradient: Some(self.add_buffer(0, shape.len())),
            ..self.add_input(shape)
        }
    }

    /// Reserves `len` places for a layer's parameters on the GPU and returns the index of the
    /// first; `param_positions` holds for each of the layer's parameters, in order, its position
    /// among these places.
    pub fn reserve_params(
        &mut self,
        len: usize,
        param_positions: impl IntoIterator<Item = usize>,
    ) -> usize {
        let start = self.num_device_params().next_multiple_of(ALIGNMENT);
        for slot in [PARAMS, GRADIENT] {
            self.buffer_lengths[slot.0].fixed_len = start + len;
        }
        self.param_positions
            .extend(param_positions.into_iter().map(|position| (start + position) as u32));
        start
    }

    /// Adds the kernels of a layer's forward pass and of its backward pass to the compute plan. The
    /// layer's backward kernels run before those of all layers added earlier.
    pub fn add_kernels(&mut self, forward: Vec<KernelDispatch>, backward: Vec<KernelDispatch>) {
        self.forward.extend(forward);
        self.backward.push(backward);
    }

    /// Adds a kernel to the compute plan that runs after the backward pass.
    pub fn add_final_kernel(&mut self, kernel: KernelDispatch) {
        self.final_kernels.push(kernel);
    }

    /// Drops the backward pass, the kernels after it, and the buffers that only these kernels use,
    /// such as gradients. Call it after all layers were added.
    #[must_use]
    pub fn forward_only(mut self) -> ComputePlan {
        self.backward.clear();
        self.final_kernels.clear();
        let buffers = self.forward.iter().flat_map(|kernel| &kernel.buffers);
        let mut used: HashSet<BufferSlot> = buffers.map(|&(slot, _)| slot).collect();
        // parameters are written from outside, whether or not a kernel reads them
        used.insert(PARAMS);
        for (slot, length) in self.buffer_lengths.iter_mut().enumerate() {
            if !used.contains(&BufferSlot(slot)) {
                *length = BufferLength::default();
            }
        }
        self.constant_tables.retain(|(slot, _)| used.contains(slot));
        self
    }

    /// Returns the temporary buffer `which`, enlarged to at least `fixed` 32-bit words and `each`
    /// more for every sample.
    pub(crate) fn shared_buffer(
        &mut self,
        which: SharedBuffer,
        fixed: usize,
        each: usize,
    ) -> BufferSlot {
        let slot = match which {
            SharedBuffer::FoldedGradient => FOLDED,
            SharedBuffer::PartialGradients => PARTIAL,
        };
        let length = &mut self.buffer_lengths[slot.0];
        length.fixed_len = length.fixed_len.max(fixed);
        length.len_per_sample = length.len_per_sample.max(each);
        slot
    }

    /// Iterates over the kernels of the backward pass, then over those of the steps that follow it,
    /// such as the optimiser's, in the order in which they run.
    pub(crate) fn backward_kernels(&self) -> impl Iterator<Item = &KernelDispatch> {
        self.backward.iter().rev().flatten().chain(&self.final_kernels)
    }

    /// Returns [`GpuError::BufferTooLarge`] if an adapter cannot hold the buffers for `samples`
    /// samples.
    pub(crate) fn check_limits(
        &self,
        adapter: &GpuAdapterInfo,
        samples: usize,
    ) -> Result<(), GpuError> {
        let largest =
            self.buffer_lengths.iter().map(|length| length.bytes(samples)).max().unwrap_or(0);
        let refused = |what, limit| GpuError::BufferTooLarge {
            adapter: adapter.name.clone(),
            what,
            needed: largest,
            limit,
        };
        if largest > adapter.max_binding_bytes {
            return Err(refused("bytes of a buffer in one binding", adapter.max_binding_bytes));
        }
        if largest > adapter.max_buffer_bytes {
            return Err(refused("bytes of a buffer", adapter.max_buffer_bytes));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::layers::R2Conv;
    use crate::layers::layer::LayerSignature;
    use crate::window::SlidingWindow;

    #[test]
    fn a_forward_plan_has_no_gradients() {
        let [from, to] = [3, 2].map(|fields| Group::D2.regular_type(fields));
        let conv = R2Conv::new(from, to, SlidingWindow::new(4, 2, 1), [8, 8]).unwrap();
        let mut plan = ComputePlan::new();
        let x = plan.add_tensor(conv.in_shape());
        let y = plan.add_layer(&conv, x).unwrap();
        let ([forward, backward], params) = (plan.num_kernels_per_pass(), plan.num_device_params());
        assert!(forward > 0 && backward > 0);
        let words = |planned: &ComputePlan, slot: BufferSlot| {
            let BufferLength { fixed_len, len_per_sample } = planned.buffer_lengths[slot.0];
            fixed_len + len_per_sample
        };
        let [dx, dy] = [x, y].map(|map| map.gradient.unwrap());
        let gradients = [dx, dy, GRADIENT, PARTIAL, FOLDED];
        assert!(gradients.iter().all(|&slot| words(&plan, slot) > 0));
        let plan = plan.forward_only();
        assert_eq!(plan.num_kernels_per_pass(), [forward, 0]);
        assert_eq!(plan.num_device_params(), params);
        assert_eq!(gradients.map(|slot| words(&plan, slot)), [0; 5]);
        let values = [x.values, y.values, PARAMS];
        assert!(values.iter().all(|&slot| words(&plan, slot) > 0));
    }
}

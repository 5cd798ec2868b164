//! Buffers and kernels of a network as data, before any device is involved.

use std::collections::HashSet;

use crate::gpu::adapter::Adapter;
use crate::gpu::error::GpuError;
use crate::gpu::step::{Slot, Step};
use crate::shape::Shape;

/// Alignment of a layer's parameters, in numbers, as WGSL vectors need it.
const ALIGNMENT: usize = 4;
/// Bytes of a number.
const WORD: usize = 4;

/// Length of a buffer in numbers of 4 bytes: `fixed` plus `each` for every sample.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extent {
    pub fixed: usize,
    pub each: usize,
}

impl Extent {
    /// Returns the number of bytes for `samples` samples.
    pub fn bytes(self, samples: usize) -> u64 {
        let of_samples = (self.each as u64).saturating_mul(samples as u64);
        let words = of_samples.saturating_add(self.fixed as u64);
        // buffers of no bytes cannot be bound; saturation makes overflows exceed every limit
        words.max(ALIGNMENT as u64).saturating_mul(WORD as u64)
    }
}

/// Feature map of a batch on a GPU, with its gradient.
#[derive(Clone, Copy, Debug)]
pub struct Tensor {
    /// Shape of one sample of the tensor.
    pub shape: Shape,
    /// Buffer of the map's values, `[N, H, W, C]`.
    pub values: Slot,
    /// Buffer of the gradient with respect to the map, `[N, H, W, C]`; `None` if it is not needed.
    pub gradient: Option<Slot>,
}

/// Working buffers that layers use one after another: no layer relies on another's contents.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shared {
    /// Gradient with respect to folded patches.
    Folded,
    /// Partial gradients with respect to parameters.
    Partial,
}

/// Buffers and kernels of networks that run together, for a [`Program`](crate::gpu::Program).
///
/// Layers are added one after the other. Parameters are stored in the order of the kernels, with
/// zeros where a WGSL vector has no parameter; [`placed`](Plan::placed) converts parameters of the
/// CPU to this order and [`unplaced`](Plan::unplaced) converts them back.
#[derive(Debug)]
pub struct Plan {
    extents: Vec<Extent>,
    tables: Vec<(Slot, Vec<u32>)>,
    forward: Vec<Step>,
    /// Steps of each layer, in the order of the forward pass.
    backward: Vec<Vec<Step>>,
    last: Vec<Step>,
    places: Vec<u32>,
}

/// Buffer of all parameters.
const PARAMS: Slot = Slot(0);
/// Buffer of the gradient with respect to all parameters.
const GRADIENT: Slot = Slot(1);
/// Buffer of [`Shared::Folded`].
const FOLDED: Slot = Slot(2);
/// Buffer of [`Shared::Partial`].
const PARTIAL: Slot = Slot(3);

impl Default for Plan {
    fn default() -> Plan {
        Plan::new()
    }
}

impl Plan {
    /// Creates a plan without kernels and buffers.
    pub fn new() -> Plan {
        Plan {
            extents: vec![Extent::default(); 4],
            tables: Vec::new(),
            forward: Vec::new(),
            backward: Vec::new(),
            last: Vec::new(),
            places: Vec::new(),
        }
    }

    /// Returns the buffer of all parameters, in the order of the kernels.
    pub fn params(&self) -> Slot {
        PARAMS
    }

    /// Returns the buffer of the gradient with respect to all parameters.
    pub fn gradient(&self) -> Slot {
        GRADIENT
    }

    /// Returns the number of parameters of all layers, without padding.
    pub fn num_params(&self) -> usize {
        self.places.len()
    }

    /// Returns the number of kernels of the forward pass, and of the backward pass with later
    /// steps.
    pub fn dispatches(&self) -> [usize; 2] {
        [self.forward.len(), self.backward().count()]
    }

    /// Returns the number of parameters on the GPU, with padding.
    pub fn device_params(&self) -> usize {
        self.extents[PARAMS.0].fixed
    }

    /// Converts parameters from the order of the layers to the order of the kernels.
    ///
    /// # Panics
    /// When there are more or fewer than [`num_params`](Plan::num_params).
    pub fn placed(&self, params: &[f32]) -> Vec<f32> {
        let (got, expected) = (params.len(), self.num_params());
        assert!(got == expected, "got {got} parameters, expected {expected}");
        let mut placed = vec![0.0; self.device_params()];
        for (&place, &param) in self.places.iter().zip(params) {
            placed[place as usize] = param;
        }
        placed
    }

    /// Converts parameters from the order of the kernels to the order of the layers, the reverse of
    /// [`placed`](Plan::placed).
    ///
    /// # Panics
    /// When there are fewer than [`device_params`](Plan::device_params).
    pub fn unplaced(&self, placed: &[f32]) -> Vec<f32> {
        self.places.iter().map(|&place| placed[place as usize]).collect()
    }

    /// Adds a buffer of `fixed` numbers of 4 bytes, and `each` more for every sample, to the plan.
    pub fn buffer(&mut self, fixed: usize, each: usize) -> Slot {
        self.extents.push(Extent { fixed, each });
        Slot(self.extents.len() - 1)
    }

    /// Adds a buffer of the constants `words` to the plan.
    pub fn table(&mut self, words: Vec<u32>) -> Slot {
        let slot = self.buffer(words.len(), 0);
        self.tables.push((slot, words));
        slot
    }

    /// Adds a map without a gradient to the plan, as an input.
    pub fn input(&mut self, shape: Shape) -> Tensor {
        Tensor { shape, values: self.buffer(0, shape.len()), gradient: None }
    }

    /// Adds a map with its gradient to the plan.
    pub fn tensor(&mut self, shape: Shape) -> Tensor {
        Tensor { gradient: Some(self.buffer(0, shape.len())), ..self.input(shape) }
    }

    /// Reserves `len` parameters on the GPU, where the layer's parameters have the positions
    /// `places`, and returns the index of the first.
    pub fn reserve(&mut self, len: usize, places: impl IntoIterator<Item = usize>) -> usize {
        let start = self.device_params().next_multiple_of(ALIGNMENT);
        for slot in [PARAMS, GRADIENT] {
            self.extents[slot.0].fixed = start + len;
        }
        self.places.extend(places.into_iter().map(|place| (start + place) as u32));
        start
    }

    /// Adds the kernels of a layer's forward pass and of its backward pass to the plan. Its
    /// backward steps run before those of all layers added earlier.
    pub fn push(&mut self, forward: Vec<Step>, backward: Vec<Step>) {
        self.forward.extend(forward);
        self.backward.push(backward);
    }

    /// Adds a kernel that runs after the backward pass to the plan.
    pub fn push_last(&mut self, step: Step) {
        self.last.push(step);
    }

    /// Drops the backward pass, later kernels, and the buffers that only they use, such as
    /// gradients. Call it after all layers were added.
    #[must_use]
    pub fn forward_only(mut self) -> Plan {
        self.backward.clear();
        self.last.clear();
        let buffers = self.forward.iter().flat_map(|step| &step.buffers);
        let mut used: HashSet<Slot> = buffers.map(|&(slot, _)| slot).collect();
        // parameters are written from outside, whether or not a step reads them
        used.insert(PARAMS);
        for (slot, extent) in self.extents.iter_mut().enumerate() {
            if !used.contains(&Slot(slot)) {
                *extent = Extent::default();
            }
        }
        self.tables.retain(|(slot, _)| used.contains(slot));
        self
    }

    /// Returns a shared buffer after enlarging it to this length.
    pub(crate) fn shared(&mut self, which: Shared, fixed: usize, each: usize) -> Slot {
        let slot = match which {
            Shared::Folded => FOLDED,
            Shared::Partial => PARTIAL,
        };
        let extent = &mut self.extents[slot.0];
        extent.fixed = extent.fixed.max(fixed);
        extent.each = extent.each.max(each);
        slot
    }

    /// Returns the lengths of all buffers, by slot.
    pub(crate) fn extents(&self) -> &[Extent] {
        &self.extents
    }

    /// Returns the buffers of constants with their contents.
    pub(crate) fn tables(&self) -> &[(Slot, Vec<u32>)] {
        &self.tables
    }

    /// Iterates over the steps of the forward pass, in order.
    pub(crate) fn forward(&self) -> impl Iterator<Item = &Step> {
        self.forward.iter()
    }

    /// Iterates over the steps of the backward pass and later ones, in order.
    pub(crate) fn backward(&self) -> impl Iterator<Item = &Step> {
        self.backward.iter().rev().flatten().chain(&self.last)
    }

    /// Returns [`GpuError::Limit`] if an adapter cannot hold the buffers for `samples` samples.
    pub(crate) fn check(&self, adapter: &Adapter, samples: usize) -> Result<(), GpuError> {
        let largest = self.extents.iter().map(|extent| extent.bytes(samples)).max().unwrap_or(0);
        let refused = |what, limit| GpuError::Limit {
            adapter: adapter.name.clone(),
            what,
            needed: largest,
            limit,
        };
        if largest > adapter.binding_bytes {
            return Err(refused("bytes of a buffer in one binding", adapter.binding_bytes));
        }
        if largest > adapter.buffer_bytes {
            return Err(refused("bytes of a buffer", adapter.buffer_bytes));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::layers::R2Conv;
    use crate::layers::layer::Signature;
    use crate::window::Kernel;

    #[test]
    fn a_forward_plan_has_no_gradients() {
        let [from, to] = [3, 2].map(|fields| Group::D2.regular(fields));
        let conv = R2Conv::new(from, to, Kernel::new(4, 2, 1), [8, 8]).unwrap();
        let mut plan = Plan::new();
        let x = plan.tensor(conv.in_shape());
        let y = plan.layer(&conv, x).unwrap();
        let ([forward, backward], params) = (plan.dispatches(), plan.device_params());
        assert!(forward > 0 && backward > 0);
        let words = |planned: &Plan, slot: Slot| {
            let Extent { fixed, each } = planned.extents()[slot.0];
            fixed + each
        };
        let [dx, dy] = [x, y].map(|map| map.gradient.unwrap());
        let gradients = [dx, dy, GRADIENT, PARTIAL, FOLDED];
        assert!(gradients.iter().all(|&slot| words(&plan, slot) > 0));
        let plan = plan.forward_only();
        assert_eq!(plan.dispatches(), [forward, 0]);
        assert_eq!(plan.device_params(), params);
        assert_eq!(gradients.map(|slot| words(&plan, slot)), [0; 5]);
        let values = [x.values, y.values, PARAMS];
        assert!(values.iter().all(|&slot| words(&plan, slot) > 0));
    }
}

//! What a network needs of a device, as data: buffers, and kernels in their order.

use std::collections::HashSet;

use crate::gpu::adapter::Adapter;
use crate::gpu::error::GpuError;
use crate::gpu::step::{Slot, Step};
use crate::shape::Shape;

/// Parameters of a layer start at multiples of this many numbers, so that vectors are aligned.
const ALIGNMENT: usize = 4;
/// Bytes of a number.
const WORD: usize = 4;

/// The length of a buffer in numbers of 4 bytes: `fixed` and `each` a sample.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extent {
    pub fixed: usize,
    pub each: usize,
}

impl Extent {
    /// The number of bytes for so many samples.
    pub fn bytes(self, samples: usize) -> u64 {
        let words = (self.each as u64).saturating_mul(samples as u64);
        let words = words.saturating_add(self.fixed as u64);
        words.max(ALIGNMENT as u64).saturating_mul(WORD as u64)
    }
}

/// A map of the batch, and the gradient in it where one is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Tensor {
    /// The shape of a sample.
    pub shape: Shape,
    /// The values, `[N, H, W, C]`.
    pub values: Slot,
    /// The gradient, in the same layout.
    pub gradient: Option<Slot>,
}

/// Buffers that kernels use one after the other, none needing what another left.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shared {
    /// The gradient in folded patches.
    Folded,
    /// Partial gradients in parameters.
    Partial,
}

/// The buffers and the kernels of networks that run together, for a
/// [`Program`](crate::gpu::Program).
///
/// Layers are added one after the other. Parameters are laid out as the kernels read them, with
/// zeros where a vector of WGSL has no parameter; [`placed`](Plan::placed) brings those of the
/// processor there and [`unplaced`](Plan::unplaced) back.
#[derive(Debug)]
pub struct Plan {
    extents: Vec<Extent>,
    tables: Vec<(Slot, Vec<u32>)>,
    forward: Vec<Step>,
    /// The steps of each layer, in the order of the forward pass.
    backward: Vec<Vec<Step>>,
    last: Vec<Step>,
    places: Vec<u32>,
}

const PARAMS: Slot = Slot(0);
const GRADIENT: Slot = Slot(1);
const FOLDED: Slot = Slot(2);
const PARTIAL: Slot = Slot(3);

impl Default for Plan {
    fn default() -> Plan {
        Plan::new()
    }
}

impl Plan {
    /// A plan of nothing.
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

    /// The buffer of all parameters, in the order of the kernels.
    pub fn params(&self) -> Slot {
        PARAMS
    }

    /// The buffer of the gradient in them.
    pub fn gradient(&self) -> Slot {
        GRADIENT
    }

    /// The number of parameters as the processor has them.
    pub fn num_params(&self) -> usize {
        self.places.len()
    }

    /// Kernels of the forward pass, and of the backward pass with what comes after it.
    pub fn dispatches(&self) -> [usize; 2] {
        [self.forward.len(), self.backward().count()]
    }

    /// The length of the device's parameters.
    pub fn device_params(&self) -> usize {
        self.extents[PARAMS.0].fixed
    }

    /// Values of all parameters in the order of the kernels.
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

    /// The reverse of [`placed`](Plan::placed).
    ///
    /// # Panics
    /// When there are fewer than [`device_params`](Plan::device_params).
    pub fn unplaced(&self, placed: &[f32]) -> Vec<f32> {
        let places = self.places.iter();
        places.map(|&place| placed[place as usize]).collect()
    }

    /// A buffer of `fixed` numbers of 4 bytes, and `each` a sample.
    pub fn buffer(&mut self, fixed: usize, each: usize) -> Slot {
        self.extents.push(Extent { fixed, each });
        Slot(self.extents.len() - 1)
    }

    /// A buffer whose contents do not change.
    pub fn table(&mut self, words: Vec<u32>) -> Slot {
        let slot = self.buffer(words.len(), 0);
        self.tables.push((slot, words));
        slot
    }

    /// A map without a gradient.
    pub fn input(&mut self, shape: Shape) -> Tensor {
        Tensor { shape, values: self.buffer(0, shape.len()), gradient: None }
    }

    /// A map with its gradient.
    pub fn tensor(&mut self, shape: Shape) -> Tensor {
        Tensor { gradient: Some(self.buffer(0, shape.len())), ..self.input(shape) }
    }

    /// Makes room for `len` parameters of the device, of which the processor's lie at `places`;
    /// returns where they start.
    pub fn reserve(&mut self, len: usize, places: impl IntoIterator<Item = usize>) -> usize {
        let start = self.device_params().next_multiple_of(ALIGNMENT);
        for slot in [PARAMS, GRADIENT] {
            self.extents[slot.0].fixed = start + len;
        }
        let places = places.into_iter().map(|place| (start + place) as u32);
        self.places.extend(places);
        start
    }

    /// Adds the steps of a layer. Those of the backward pass run before those of all layers that
    /// were added earlier.
    pub fn push(&mut self, forward: Vec<Step>, backward: Vec<Step>) {
        self.forward.extend(forward);
        self.backward.push(backward);
    }

    /// Adds a step after the backward pass.
    pub fn push_last(&mut self, step: Step) {
        self.last.push(step);
    }

    /// The forward pass alone: without the backward pass, what comes after it, and the buffers that
    /// only those use, the gradient among them. It comes after all layers were added.
    #[must_use]
    pub fn forward_only(mut self) -> Plan {
        self.backward.clear();
        self.last.clear();
        let used = self.forward.iter().flat_map(|step| &step.buffers);
        let mut used: HashSet<Slot> = used.map(|&(slot, _)| slot).collect();
        used.insert(PARAMS);
        for (slot, extent) in self.extents.iter_mut().enumerate() {
            if !used.contains(&Slot(slot)) {
                *extent = Extent::default();
            }
        }
        self.tables.retain(|(slot, _)| used.contains(slot));
        self
    }

    /// A buffer that is shared, with room for so many numbers.
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

    /// The lengths of all buffers, by their slots.
    pub(crate) fn extents(&self) -> &[Extent] {
        &self.extents
    }

    /// Buffers whose contents do not change, and these.
    pub(crate) fn tables(&self) -> &[(Slot, Vec<u32>)] {
        &self.tables
    }

    /// The steps of the forward pass, in their order.
    pub(crate) fn forward(&self) -> impl Iterator<Item = &Step> {
        self.forward.iter()
    }

    /// The steps of the backward pass and what comes after it, in their order.
    pub(crate) fn backward(&self) -> impl Iterator<Item = &Step> {
        self.backward.iter().rev().flatten().chain(&self.last)
    }

    /// Refuses a plan whose buffers for so many samples an adapter cannot hold.
    pub(crate) fn check(&self, adapter: &Adapter, samples: usize) -> Result<(), GpuError> {
        let bytes = self.extents.iter().map(|extent| extent.bytes(samples));
        let largest = bytes.max().unwrap_or(0);
        let refused = |what, limit| GpuError::Limit {
            adapter: adapter.name.clone(),
            what,
            needed: largest,
            limit,
        };
        if largest > adapter.binding_bytes {
            return Err(refused("bytes that a kernel sees of a buffer", adapter.binding_bytes));
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
        let words = |plan: &Plan, slot: Slot| {
            let Extent { fixed, each } = plan.extents()[slot.0];
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

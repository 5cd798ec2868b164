//! What a network needs of a device, as data: buffers, and kernels in their order.

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
        let words = self.each as u64 * samples as u64 + self.fixed as u64;
        words.max(ALIGNMENT as u64) * WORD as u64
    }
}

/// A map of the batch, and the gradient in it where one is wanted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tensor {
    pub shape: Shape,
    pub values: Slot,
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

/// The buffers and the kernels of a network.
#[derive(Debug)]
pub(crate) struct Plan {
    extents: Vec<Extent>,
    /// Buffers with contents that do not change.
    pub tables: Vec<(Slot, Vec<u32>)>,
    pub forward: Vec<Step>,
    /// The steps of each layer, in the order of the forward pass.
    backward: Vec<Vec<Step>>,
    /// For each parameter of the processor's, its place among those of the device.
    pub places: Vec<u32>,
    /// All parameters, in the order of the kernels.
    pub params: Slot,
    /// The gradient in them.
    pub gradient: Slot,
    folded: Slot,
    partial: Slot,
}

impl Plan {
    pub fn new() -> Plan {
        Plan {
            extents: vec![Extent::default(); 4],
            tables: Vec::new(),
            forward: Vec::new(),
            backward: Vec::new(),
            places: Vec::new(),
            params: Slot(0),
            gradient: Slot(1),
            folded: Slot(2),
            partial: Slot(3),
        }
    }

    /// The lengths of all buffers, by their slots.
    pub fn extents(&self) -> &[Extent] {
        &self.extents
    }

    /// The length of the device's parameters.
    pub fn device_params(&self) -> usize {
        self.extents[self.params.0].fixed
    }

    /// The steps of the backward pass, in their order.
    pub fn backward(&self) -> impl Iterator<Item = &Step> {
        self.backward.iter().rev().flatten()
    }

    /// A buffer of so many numbers.
    pub fn buffer(&mut self, fixed: usize, each: usize) -> Slot {
        self.extents.push(Extent { fixed, each });
        Slot(self.extents.len() - 1)
    }

    /// A buffer with these contents.
    pub fn table(&mut self, words: Vec<u32>) -> Slot {
        let slot = self.buffer(words.len(), 0);
        self.tables.push((slot, words));
        slot
    }

    /// A map with its gradient.
    pub fn tensor(&mut self, shape: Shape) -> Tensor {
        Tensor {
            shape,
            values: self.buffer(0, shape.len()),
            gradient: Some(self.buffer(0, shape.len())),
        }
    }

    /// A buffer that is shared, with room for so many numbers.
    pub fn shared(&mut self, which: Shared, fixed: usize, each: usize) -> Slot {
        let slot = match which {
            Shared::Folded => self.folded,
            Shared::Partial => self.partial,
        };
        let extent = &mut self.extents[slot.0];
        extent.fixed = extent.fixed.max(fixed);
        extent.each = extent.each.max(each);
        slot
    }

    /// Makes room for `len` parameters of the device, of which the processor's lie at `places`;
    /// returns where they start.
    pub fn reserve(&mut self, len: usize, places: impl IntoIterator<Item = usize>) -> usize {
        let start = self.device_params().next_multiple_of(ALIGNMENT);
        for slot in [self.params, self.gradient] {
            self.extents[slot.0].fixed = start + len;
        }
        let places = places.into_iter().map(|place| (start + place) as u32);
        self.places.extend(places);
        start
    }

    /// Adds the steps of a layer.
    pub fn push(&mut self, forward: Vec<Step>, backward: Vec<Step>) {
        self.forward.extend(forward);
        self.backward.push(backward);
    }

    /// Refuses a plan whose buffers for so many samples an adapter cannot hold.
    pub fn check(&self, adapter: &Adapter, samples: usize) -> Result<(), GpuError> {
        let bytes = self.extents.iter().map(|extent| extent.bytes(samples));
        let largest = bytes.max().unwrap_or(0);
        let refused = |what, limit| GpuError::Limit {
            adapter: adapter.name.clone(),
            what,
            needed: largest,
            limit,
        };
        if largest > adapter.binding_bytes {
            return Err(refused(
                "bytes that a kernel sees of a buffer",
                adapter.binding_bytes,
            ));
        }
        if largest > adapter.buffer_bytes {
            return Err(refused("bytes of a buffer", adapter.buffer_bytes));
        }
        Ok(())
    }
}

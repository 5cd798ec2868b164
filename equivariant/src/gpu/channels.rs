//! Positions of a field's components among the channels of a pixel, and WGSL that accesses them.

use symmetry::FieldType;

use crate::gpu::kernel_dispatch::{BufferSlot, KernelDispatch};

/// WGSL accessors of a field's components, for symmetry groups of 1, 2 and 4 elements.
const COMPONENTS: [&[&str]; 3] = [&[""], &[".x", ".y"], &[".x", ".y", ".z", ".w"]];

/// Layout of fields among the channels of a pixel: component a of field f is channel `starts[a] +
/// f` if f is below `counts[a]`, and zero otherwise.
#[derive(Clone, Debug)]
pub(crate) struct ChannelLayout {
    /// Number of channels of a pixel.
    dim: usize,
    starts: Vec<usize>,
    counts: Vec<usize>,
}

impl ChannelLayout {
    /// Creates the channel layout of a field type: fields with a component for each irrep of its
    /// group. Irreps with fewer channels than others are padded with zeros.
    pub fn for_type(fields: FieldType) -> ChannelLayout {
        let irreps = fields.group().irreps();
        ChannelLayout {
            dim: fields.dim(),
            starts: irreps.iter().map(|&a| fields.channel_range(a).start).collect(),
            counts: irreps.iter().map(|&a| fields.multiplicity(a)).collect(),
        }
    }

    /// Creates the channel layout of `dim` fields of one component.
    pub fn for_single_channel_fields(dim: usize) -> ChannelLayout {
        ChannelLayout::for_regular_fields(1, dim)
    }

    /// Creates the channel layout of `fields` fields of `order` components.
    pub fn for_regular_fields(order: usize, fields: usize) -> ChannelLayout {
        ChannelLayout {
            dim: order * fields,
            starts: (0..order).map(|a| a * fields).collect(),
            counts: vec![fields; order],
        }
    }

    /// Returns the layout of the same fields in pixels of `dim` channels, with component a of all
    /// fields from channel `starts[a]` on.
    pub fn with_component_starts(mut self, dim: usize, starts: Vec<usize>) -> ChannelLayout {
        self.dim = dim;
        self.starts = starts;
        self
    }

    /// Returns the layout of these fields within a direct sum of two maps whose layout is `sum` and
    /// whose first map they form.
    pub fn as_first_summand(&self, sum: &ChannelLayout) -> ChannelLayout {
        self.clone().with_component_starts(sum.dim, sum.starts.clone())
    }

    /// Returns the layout of these fields within a direct sum of two maps whose layout is `sum` and
    /// whose second map they form.
    pub fn as_second_summand(&self, sum: &ChannelLayout) -> ChannelLayout {
        let ends = sum.starts.iter().zip(&sum.counts).map(|(start, count)| start + count);
        let starts = ends.zip(&self.counts).map(|(end, count)| end - count);
        self.clone().with_component_starts(sum.dim, starts.collect())
    }

    /// Returns the number of fields of a pixel, some of which may lack components.
    pub fn num_fields(&self) -> usize {
        self.counts.iter().copied().max().unwrap_or(0)
    }

    /// Returns the number of components of a field.
    pub fn components_per_field(&self) -> usize {
        self.counts.len()
    }

    /// Adds an input feature map of this layout to a kernel, and the WGSL function
    /// `load_NAME(pixel, field)` that reads a field of it.
    pub fn add_input_to_kernel(
        &self,
        kernel: KernelDispatch,
        name: &str,
        slot: BufferSlot,
    ) -> KernelDispatch {
        let kernel = kernel.add_input_buffer(name, "f32", slot);
        let body = self.statements(|lane, at| format!("v{lane} = {name}[{at}];"));
        let head = format!("fn load_{name}(pixel: u32, field: u32) -> Field {{ var v = Field();");
        kernel.add_wgsl(&format!("{head} {body} return v; }}"))
    }

    /// Adds an output feature map of this layout to a kernel, and the WGSL function
    /// `store_NAME(pixel, field, v)` that writes a field of it.
    pub fn add_output_to_kernel(
        &self,
        kernel: KernelDispatch,
        name: &str,
        slot: BufferSlot,
    ) -> KernelDispatch {
        let kernel = kernel.add_output_buffer(name, "f32", slot);
        let body = self.statements(|lane, at| format!("{name}[{at}] = v{lane};"));
        let head = format!("fn store_{name}(pixel: u32, field: u32, v: Field) {{");
        kernel.add_wgsl(&format!("{head} {body} }}"))
    }

    /// Joins WGSL statements, one for each component of a field.
    fn statements(&self, statement: impl Fn(&str, String) -> String) -> String {
        // orders 1, 2 and 4 are entries 0, 1 and 2
        let lanes =
            COMPONENTS[self.components_per_field().ilog2() as usize].iter().zip(&self.starts);
        let lanes = lanes.zip(&self.counts).filter(|(_, count)| **count > 0);
        let statements = lanes.map(|((lane, start), &count)| {
            let at = format!("pixel * {}u + {start}u + field", self.dim);
            // irreps with fewer channels than others have no component for the last fields
            if count < self.num_fields() {
                format!("if field < {count}u {{ {} }} ", statement(lane, at))
            } else {
                statement(lane, at) + " "
            }
        });
        statements.collect()
    }
}

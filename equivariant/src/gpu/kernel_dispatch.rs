//! GPU kernels with the buffers on which they run.

/// Index of a GPU buffer among those of a [`ComputePlan`](crate::gpu::ComputePlan).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BufferSlot(pub(crate) usize);

/// Number of workgroups of a GPU kernel for a batch of N samples: `times` * ceil((`each` * N +
/// `fixed`) / `tile`).
#[derive(Clone, Copy, Debug)]
pub struct WorkgroupCount {
    each: usize,
    fixed: usize,
    tile: usize,
    times: usize,
}

/// Number of threads of a GPU workgroup, equal to `THREADS` in `common.wgsl`.
pub(crate) const WORKGROUP_THREADS: usize = 64;

impl WorkgroupCount {
    /// Returns the number of workgroups of a kernel with `each` threads for every sample.
    pub fn for_threads_per_sample(each: usize) -> WorkgroupCount {
        WorkgroupCount { each, fixed: 0, tile: WORKGROUP_THREADS, times: 1 }
    }

    /// Returns the number of workgroups of a kernel with `fixed` threads, independent of the number
    /// of samples.
    pub fn for_fixed_threads(fixed: usize) -> WorkgroupCount {
        WorkgroupCount { each: 0, fixed, tile: WORKGROUP_THREADS, times: 1 }
    }

    /// Returns the number of workgroups of a kernel with `fixed` workgroups, independent of the
    /// number of samples.
    pub fn for_fixed_workgroups(fixed: usize) -> WorkgroupCount {
        WorkgroupCount { each: 0, fixed, tile: 1, times: 1 }
    }

    /// Returns the number of workgroups of a matrix product with `times` workgroups for each tile
    /// of `tile` rows.
    pub(crate) fn per_tile_of_rows(rows: DynamicDim, tile: usize, times: usize) -> WorkgroupCount {
        let (each, fixed) = match rows {
            DynamicDim::PerSample(each) => (each, 0),
            DynamicDim::Fixed(fixed) => (0, fixed),
        };
        WorkgroupCount { each, fixed, tile, times }
    }

    /// Returns the number of workgroups for a batch of `samples` samples.
    pub(crate) fn num_workgroups(self, samples: usize) -> usize {
        (self.each * samples + self.fixed).div_ceil(self.tile) * self.times
    }
}

/// Size along an axis of a matrix: a multiple of the number of samples in the batch, or fixed.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DynamicDim {
    PerSample(usize),
    Fixed(usize),
}

impl DynamicDim {
    /// Returns the size for the current batch as a WGSL expression.
    pub fn wgsl_expression(self) -> String {
        match self {
            DynamicDim::PerSample(each) => format!("batch.samples * {each}u"),
            DynamicDim::Fixed(fixed) => format!("{fixed}u"),
        }
    }
}

/// Dispatch of a GPU kernel: its WGSL text, its buffers in the order of their bindings, and its
/// number of workgroups.
#[derive(Clone, Debug)]
pub struct KernelDispatch {
    pub(crate) label: &'static str,
    source: String,
    /// `true` if the kernel calls `summed`.
    has_workgroup_sum: bool,
    /// Buffers of the kernel in the order of their bindings, each with `true` if the kernel writes
    /// it.
    pub(crate) buffers: Vec<(BufferSlot, bool)>,
    pub(crate) workgroups: WorkgroupCount,
}

impl KernelDispatch {
    /// Creates a GPU kernel without buffers, on fields of `order` components: 1, 2 or 4.
    ///
    /// Its text begins with `wgsl/common.wgsl`, which declares the batch and derives indices from a
    /// thread's `Place`, and with `wgsl/group_1.wgsl`, `group_2.wgsl` or `group_4.wgsl`, which has
    /// the arithmetic of a field. A kernel's `main` takes a `Place` (`wgsl/place.wgsl`), whose
    /// `thread` is the index of the thread in its workgroup.
    pub fn new(label: &'static str, order: usize, work: WorkgroupCount) -> KernelDispatch {
        let group = match order {
            1 => include_str!("wgsl/group_1.wgsl"),
            2 => include_str!("wgsl/group_2.wgsl"),
            _ => include_str!("wgsl/group_4.wgsl"),
        };
        KernelDispatch {
            label,
            source: [include_str!("wgsl/common.wgsl"), group].concat(),
            has_workgroup_sum: false,
            buffers: Vec::new(),
            workgroups: work,
        }
    }

    /// Adds WGSL text to the source of the GPU kernel.
    pub fn add_wgsl(mut self, text: &str) -> KernelDispatch {
        self.source.push_str(text);
        self.source.push('\n');
        self
    }

    /// Adds named constants of type u32 to the kernel's source.
    pub fn add_u32_constants<const N: usize>(
        self,
        constants: [(&str, usize); N],
    ) -> KernelDispatch {
        constants.into_iter().fold(self, |kernel, (name, value)| {
            kernel.add_wgsl(&format!("const {name} = {value}u;"))
        })
    }

    /// Adds a named constant of type f32 to the kernel's source: the finite value nearest to
    /// `value`.
    pub fn add_f32_constant(self, name: &str, value: f64) -> KernelDispatch {
        let value = value.clamp(f64::from(f32::MIN), f64::from(f32::MAX));
        // Debug prints the shortest decimal that reads back as the same value, with a point or an
        // exponent
        self.add_wgsl(&format!("const {name}: f32 = {:?};", value as f32))
    }

    /// Adds the WGSL function `summed(value, place)`, the sum over the threads of a workgroup,
    /// where `place` is the argument of `main`. All threads of the workgroup must call it.
    pub fn add_workgroup_sum(mut self) -> KernelDispatch {
        self.has_workgroup_sum = true;
        self
    }

    /// Returns the complete WGSL text of the kernel, with or without subgroup operations.
    pub(crate) fn wgsl_source(&self, subgroups: bool) -> String {
        // kernels without a sum need no subgroup extension
        let (place, sum) = match (self.has_workgroup_sum, subgroups) {
            (true, true) => (
                include_str!("wgsl/place_in_subgroups.wgsl"),
                include_str!("wgsl/sum_in_subgroups.wgsl"),
            ),
            (true, false) => {
                (include_str!("wgsl/place.wgsl"), include_str!("wgsl/workgroup_sum.wgsl"))
            }
            (false, _) => (include_str!("wgsl/place.wgsl"), ""),
        };
        [&self.source, place, sum].concat()
    }

    /// Adds an input buffer to the GPU kernel as an array of the WGSL type `element`.
    pub fn add_input_buffer(self, name: &str, element: &str, slot: BufferSlot) -> KernelDispatch {
        self.buffer(name, element, slot, false)
    }

    /// Adds an output buffer to the GPU kernel as an array of the WGSL type `element`.
    pub fn add_output_buffer(self, name: &str, element: &str, slot: BufferSlot) -> KernelDispatch {
        self.buffer(name, element, slot, true)
    }

    fn buffer(
        mut self,
        name: &str,
        element: &str,
        slot: BufferSlot,
        written: bool,
    ) -> KernelDispatch {
        let access = if written { "read_write" } else { "read" };
        self.buffers.push((slot, written));
        // binding 0 is the batch, so the first buffer has binding 1
        let binding = self.buffers.len();
        self.add_wgsl(&format!(
            "@group(0) @binding({binding}) var<storage, {access}> {name}: array<{element}>;"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_kernels_that_sum_values_have_operations_on_subgroups() {
        let kernel = || KernelDispatch::new("some", 4, WorkgroupCount::for_fixed_workgroups(1));
        let has =
            |made: KernelDispatch, subgroups| made.wgsl_source(subgroups).contains("subgroup");
        assert!(
            has(kernel().add_workgroup_sum(), true) && !has(kernel().add_workgroup_sum(), false)
        );
        assert!(!has(kernel(), true) && !has(kernel(), false));
    }
}

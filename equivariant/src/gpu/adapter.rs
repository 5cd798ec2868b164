//! GPUs of this machine, and software drivers that emulate one.

use std::fmt;

/// Kind of hardware behind a GPU adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GpuAdapterKind {
    /// GPU with its own memory.
    Discrete,
    /// GPU that shares the CPU's memory.
    Integrated,
    /// GPU of a virtual machine.
    Virtual,
    /// Software driver on the CPU, for tests.
    Software,
    /// Unknown kind of hardware.
    Other,
}

impl GpuAdapterKind {
    /// Returns `true` if the adapter is certainly a GPU.
    pub fn is_hardware(self) -> bool {
        !matches!(self, GpuAdapterKind::Software | GpuAdapterKind::Other)
    }
}

impl fmt::Display for GpuAdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            GpuAdapterKind::Discrete => "discrete GPU",
            GpuAdapterKind::Integrated => "integrated GPU",
            GpuAdapterKind::Virtual => "virtual GPU",
            GpuAdapterKind::Software => "software",
            GpuAdapterKind::Other => "other",
        })
    }
}

/// Description of a GPU adapter, as its driver reports it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuAdapterInfo {
    /// Name of the adapter's hardware, such as `NVIDIA H100 80GB HBM3`.
    pub name: String,
    /// Kind of the adapter's hardware.
    pub kind: GpuAdapterKind,
    /// Programming interface that reaches the adapter, such as `vulkan`.
    pub backend: String,
    /// Name and version of the adapter's driver.
    pub driver: String,
    /// Maximum size in bytes of a buffer that one kernel can access.
    pub max_binding_bytes: u64,
    /// Maximum size in bytes of a buffer on the adapter.
    pub max_buffer_bytes: u64,
    /// Maximum size in bytes of the memory that the threads of a workgroup share.
    pub max_shared_bytes: u32,
    /// Maximum number of threads of a workgroup.
    pub max_workgroup_threads: u32,
    /// Minimum and maximum number of threads of a subgroup, which run in lockstep. No kernel relies
    /// on their number.
    pub subgroup_sizes: [u32; 2],
}

impl fmt::Display for GpuAdapterInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [binding, buffer] =
            [self.max_binding_bytes, self.max_buffer_bytes].map(|bytes| bytes >> 20);
        write!(
            f,
            "{} ({}, {}, {}; {binding} MiB a binding, {buffer} MiB a buffer, {} B shared by {} \
             threads)",
            self.name,
            self.kind,
            self.backend,
            self.driver,
            self.max_shared_bytes,
            self.max_workgroup_threads
        )
    }
}

/// Returns all Vulkan adapters of this machine, real GPUs before software drivers; empty if no
/// driver is installed.
pub fn available_gpu_adapters() -> Vec<GpuAdapterInfo> {
    wgpu_adapters().iter().map(describe_adapter).collect()
}

/// Returns wgpu's handles of the [`available_gpu_adapters`], in the same order.
pub(crate) fn wgpu_adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    let instance = wgpu::Instance::new(descriptor);
    let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    found.sort_by_key(|adapter| rank(kind(adapter.get_info().device_type)));
    found
}

/// Converts wgpu's information about a GPU adapter into a [`GpuAdapterInfo`].
pub(crate) fn describe_adapter(adapter: &wgpu::Adapter) -> GpuAdapterInfo {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    GpuAdapterInfo {
        kind: kind(info.device_type),
        backend: info.backend.to_string(),
        driver: format!("{} {}", info.driver, info.driver_info),
        name: info.name,
        max_binding_bytes: limits.max_storage_buffer_binding_size,
        max_buffer_bytes: limits.max_buffer_size,
        max_shared_bytes: limits.max_compute_workgroup_storage_size,
        max_workgroup_threads: limits.max_compute_invocations_per_workgroup,
        subgroup_sizes: [info.subgroup_min_size, info.subgroup_max_size],
    }
}

fn kind(device: wgpu::DeviceType) -> GpuAdapterKind {
    match device {
        wgpu::DeviceType::DiscreteGpu => GpuAdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => GpuAdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => GpuAdapterKind::Virtual,
        wgpu::DeviceType::Cpu => GpuAdapterKind::Software,
        wgpu::DeviceType::Other => GpuAdapterKind::Other,
    }
}

/// Returns the rank of an adapter's kind in the order of preference; 0 is best.
fn rank(kind: GpuAdapterKind) -> u8 {
    match kind {
        GpuAdapterKind::Discrete => 0,
        GpuAdapterKind::Virtual => 1,
        GpuAdapterKind::Integrated => 2,
        GpuAdapterKind::Other => 3,
        GpuAdapterKind::Software => 4,
    }
}

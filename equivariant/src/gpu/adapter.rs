//! The GPUs of this machine, and software that stands in for one.

use std::fmt;

/// What runs an adapter's commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AdapterKind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU that a virtual machine is given.
    Virtual,
    /// The processor itself: for tests.
    Software,
    /// Something else.
    Other,
}

impl AdapterKind {
    /// Whether it is a GPU for certain.
    pub fn is_hardware(self) -> bool {
        !matches!(self, AdapterKind::Software | AdapterKind::Other)
    }
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            AdapterKind::Discrete => "discrete GPU",
            AdapterKind::Integrated => "integrated GPU",
            AdapterKind::Virtual => "virtual GPU",
            AdapterKind::Software => "software",
            AdapterKind::Other => "other",
        })
    }
}

/// An adapter, as its driver describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adapter {
    /// Its name, such as `NVIDIA H100 80GB HBM3`.
    pub name: String,
    /// What it is.
    pub kind: AdapterKind,
    /// The programming interface that reaches it, such as `vulkan`.
    pub backend: String,
    /// Name and version of the driver.
    pub driver: String,
    /// The most bytes that a kernel sees of a buffer.
    pub binding_bytes: u64,
    /// The most bytes of a buffer.
    pub buffer_bytes: u64,
    /// The most bytes that the threads of a group share.
    pub shared_bytes: u32,
    /// The most threads of a group.
    pub group_threads: u32,
    /// The fewest and the most threads of a subgroup, which run in lockstep. No kernel relies on
    /// their number.
    pub subgroup: [u32; 2],
}

impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [binding, buffer] = [self.binding_bytes, self.buffer_bytes].map(|bytes| bytes >> 20);
        write!(
            f,
            "{} ({}, {}, {}; {binding} MiB a binding, {buffer} MiB a buffer, {} B shared by {} \
             threads)",
            self.name, self.kind, self.backend, self.driver, self.shared_bytes, self.group_threads
        )
    }
}

/// The adapters that can run networks, real GPUs first; none where no driver is installed.
pub fn adapters() -> Vec<Adapter> {
    found().iter().map(describe).collect()
}

/// The same, to be opened.
pub(crate) fn found() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    let instance = wgpu::Instance::new(descriptor);
    let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    found.sort_by_key(|adapter| rank(kind(adapter.get_info().device_type)));
    found
}

pub(crate) fn describe(adapter: &wgpu::Adapter) -> Adapter {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    Adapter {
        kind: kind(info.device_type),
        backend: info.backend.to_string(),
        driver: format!("{} {}", info.driver, info.driver_info),
        name: info.name,
        binding_bytes: limits.max_storage_buffer_binding_size,
        buffer_bytes: limits.max_buffer_size,
        shared_bytes: limits.max_compute_workgroup_storage_size,
        group_threads: limits.max_compute_invocations_per_workgroup,
        subgroup: [info.subgroup_min_size, info.subgroup_max_size],
    }
}

fn kind(device: wgpu::DeviceType) -> AdapterKind {
    match device {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        wgpu::DeviceType::Other => AdapterKind::Other,
    }
}

/// The order in which adapters are preferred.
fn rank(kind: AdapterKind) -> u8 {
    match kind {
        AdapterKind::Discrete => 0,
        AdapterKind::Virtual => 1,
        AdapterKind::Integrated => 2,
        AdapterKind::Other => 3,
        AdapterKind::Software => 4,
    }
}

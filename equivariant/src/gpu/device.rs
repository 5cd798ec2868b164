//! A device that runs kernels.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::gpu::adapter::{Adapter, describe, found};
use crate::gpu::error::GpuError;

/// An opened adapter. Clones are the same device.
#[derive(Clone)]
pub struct Device {
    adapter: Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    /// Compiled kernels by their text.
    pub(crate) pipelines: Arc<Mutex<HashMap<String, wgpu::ComputePipeline>>>,
    fault: Fault,
    /// Whether kernels use operations on subgroups.
    subgroups: bool,
}

/// Features that are used where an adapter has them.
const OPTIONAL: wgpu::Features = wgpu::Features::SUBGROUP.union(wgpu::Features::TIMESTAMP_QUERY);

/// The first thing that went wrong, if anything did.
type Fault = Arc<Mutex<Option<GpuError>>>;

impl Device {
    /// Opens the adapter whose name contains `name`, whatever the case; without a name the first of
    /// [`adapters`](crate::gpu::adapters), which is real hardware where there is any.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] and [`GpuError::NoDevice`].
    pub fn open(name: Option<&str>) -> Result<Device, GpuError> {
        let found = found();
        let names: Vec<String> = found.iter().map(|adapter| describe(adapter).name).collect();
        let wanted = name.unwrap_or_default().to_lowercase();
        let index = names.iter().position(|name| name.to_lowercase().contains(&wanted));
        let adapter = index.map(|index| &found[index]);
        let adapter = adapter.ok_or_else(|| GpuError::NoAdapter {
            wanted: name.map_or("at all".to_owned(), |name| format!("named `{name}`")),
            found: names,
        })?;
        Device::request(adapter)
    }

    fn request(adapter: &wgpu::Adapter) -> Result<Device, GpuError> {
        let described = describe(adapter);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("covers"),
            required_features: adapter.features() & OPTIONAL,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let requested = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = requested.map_err(|error| GpuError::NoDevice {
            adapter: described.name.clone(),
            reason: error.to_string(),
        })?;
        let fault = watch(&device, &described.name);
        Ok(Device {
            adapter: described,
            device,
            queue,
            pipelines: Arc::default(),
            fault,
            subgroups: adapter.features().contains(wgpu::Features::SUBGROUP),
        })
    }

    /// The adapter.
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// Whether the kernels that are compiled from here on use operations on subgroups of threads:
    /// they do where the adapter has them.
    pub fn subgroups(&self) -> bool {
        self.subgroups
    }

    /// The same device, whose kernels use no such operations, for comparing. Sums are added in
    /// another order then.
    pub fn without_subgroups(mut self) -> Device {
        self.subgroups = false;
        self
    }

    /// Gives the device up, as a driver does that is reset: whatever is asked of it from here on is
    /// [`GpuError::Lost`].
    pub fn close(&self) {
        self.device.destroy();
        let reason = "it was closed".to_owned();
        let adapter = self.adapter.name.clone();
        note(&self.fault, GpuError::Lost { adapter, reason });
    }

    /// What went wrong since the last check, if anything did. A lost device stays lost.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        let mut fault = locked(&self.fault);
        let error = match &*fault {
            Some(lost @ GpuError::Lost { .. }) => Some(lost.clone()),
            _ => fault.take(),
        };
        error.map_or(Ok(()), Err)
    }

    /// A buffer of so many bytes, of zeros, for kernels.
    pub(crate) fn buffer(&self, size: u64) -> wgpu::Buffer {
        let copied = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        self.allocate("values", size, wgpu::BufferUsages::STORAGE | copied)
    }

    /// A buffer of so many bytes that all threads read.
    pub(crate) fn uniform(&self, size: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        self.allocate("batch", size, usage)
    }

    /// A buffer that the processor reads.
    pub(crate) fn staging(&self, size: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        self.allocate("staging", size, usage)
    }

    /// Waits for all that was started.
    pub(crate) fn wait(&self) -> Result<(), GpuError> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|error| self.failed(error))?;
        Ok(())
    }

    /// The contents of a mapped buffer.
    pub(crate) fn mapped<T: bytemuck::Pod>(
        &self,
        staged: &wgpu::Buffer,
    ) -> Result<Vec<T>, GpuError> {
        let view = staged.get_mapped_range(..);
        let view = view.map_err(|error| self.failed(error))?;
        Ok(bytemuck::pod_collect_to_vec(&view))
    }

    fn allocate(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    pub(crate) fn failed(&self, error: impl fmt::Display) -> GpuError {
        GpuError::Failed { adapter: self.adapter.name.clone(), reason: error.to_string() }
    }
}

/// Whether they are one device, opened once.
impl PartialEq for Device {
    fn eq(&self, other: &Device) -> bool {
        self.device == other.device
    }
}

impl fmt::Debug for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Device({})", self.adapter)
    }
}

/// Notes what goes wrong on a device: without this, wgpu panics.
fn watch(device: &wgpu::Device, adapter: &str) -> Fault {
    let fault = Fault::default();
    let (lost, failed) = (fault.clone(), fault.clone());
    let (of_lost, of_failed) = (adapter.to_owned(), adapter.to_owned());
    device.set_device_lost_callback(move |_, reason| {
        let adapter = of_lost.clone();
        note(&lost, GpuError::Lost { adapter, reason });
    });
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        let (adapter, reason) = (of_failed.clone(), error.to_string());
        note(&failed, GpuError::Failed { adapter, reason });
    }));
    fault
}

/// Keeps the first fault, since later ones follow from it, but for the loss of the device.
fn note(fault: &Fault, error: GpuError) {
    let mut fault = locked(fault);
    let known = matches!(&*fault, Some(GpuError::Lost { .. }));
    if fault.is_none() || (!known && matches!(error, GpuError::Lost { .. })) {
        *fault = Some(error);
    }
}

/// What a mutex holds. Nothing that runs under it can leave it half written.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

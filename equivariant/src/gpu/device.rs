//! GPU device that runs kernels.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::gpu::adapter::{GpuAdapterInfo, describe_adapter, wgpu_adapters};
use crate::gpu::error::GpuError;

/// Opened GPU adapter, on which networks run. Clones share one device.
#[derive(Clone)]
pub struct GpuDevice {
    adapter: GpuAdapterInfo,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    /// Compiled kernels by their WGSL text.
    pub(crate) pipelines: Arc<Mutex<HashMap<String, wgpu::ComputePipeline>>>,
    first_error: FirstError,
    /// `true` if kernels use subgroup operations.
    subgroups: bool,
}

/// Optional GPU features, enabled if the adapter has them: subgroup operations and timestamps.
const OPTIONAL_FEATURES: wgpu::Features =
    wgpu::Features::SUBGROUP.union(wgpu::Features::TIMESTAMP_QUERY);

/// First error of a GPU device since the last check; `None` if there was none.
type FirstError = Arc<Mutex<Option<GpuError>>>;

impl GpuDevice {
    /// Opens the first adapter whose name contains `name`, ignoring case, or, without a name, the
    /// first of [`available_gpu_adapters`](crate::gpu::available_gpu_adapters), which is real
    /// hardware if there is any.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] and [`GpuError::NoDevice`].
    pub fn open(name: Option<&str>) -> Result<GpuDevice, GpuError> {
        let found = wgpu_adapters();
        let names: Vec<String> =
            found.iter().map(|adapter| describe_adapter(adapter).name).collect();
        let wanted = name.unwrap_or_default().to_lowercase();
        let index =
            names.iter().position(|adapter_name| adapter_name.to_lowercase().contains(&wanted));
        let adapter = index.map(|index| &found[index]).ok_or_else(|| GpuError::NoAdapter {
            wanted: name.map_or("at all".to_owned(), |name| format!("named `{name}`")),
            found: names,
        })?;
        GpuDevice::request(adapter)
    }

    fn request(adapter: &wgpu::Adapter) -> Result<GpuDevice, GpuError> {
        let described = describe_adapter(adapter);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("covers"),
            required_features: adapter.features() & OPTIONAL_FEATURES,
            // wgpu's default limits allow bindings of 128 MiB only
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let requested = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = requested.map_err(|error| GpuError::NoDevice {
            adapter: described.name.clone(),
            reason: error.to_string(),
        })?;
        let first_error = record_errors_of(&device, &described.name);
        Ok(GpuDevice {
            adapter: described,
            device,
            queue,
            pipelines: Arc::default(),
            first_error,
            subgroups: adapter.features().contains(wgpu::Features::SUBGROUP),
        })
    }

    /// Returns the description of the opened adapter.
    pub fn adapter(&self) -> &GpuAdapterInfo {
        &self.adapter
    }

    /// Returns `true` if newly compiled kernels use subgroup operations; they do if the adapter has
    /// them, unless they were turned off.
    pub fn uses_subgroup_operations(&self) -> bool {
        self.subgroups
    }

    /// Turns subgroup operations off for newly compiled kernels, for comparisons. The order of sums
    /// differs then.
    pub fn without_subgroup_operations(mut self) -> GpuDevice {
        self.subgroups = false;
        self
    }

    /// Destroys the device, like a driver reset: every later operation fails with
    /// [`GpuError::DeviceLost`].
    pub fn close(&self) {
        self.device.destroy();
        let reason = "it was closed".to_owned();
        let adapter = self.adapter.name.clone();
        record_error(&self.first_error, GpuError::DeviceLost { adapter, reason });
    }

    /// Returns and clears the first error of the device since the last check. A lost device stays
    /// lost.
    pub(crate) fn take_error(&self) -> Result<(), GpuError> {
        let mut first_error = lock_even_if_poisoned(&self.first_error);
        let error = match &*first_error {
            Some(lost @ GpuError::DeviceLost { .. }) => Some(lost.clone()),
            _ => first_error.take(),
        };
        error.map_or(Ok(()), Err)
    }

    /// Allocates a buffer of `size` bytes for kernels, filled with zeros.
    pub(crate) fn allocate_storage(&self, size: u64) -> wgpu::Buffer {
        let copied = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        self.allocate("values", size, wgpu::BufferUsages::STORAGE | copied)
    }

    /// Allocates a uniform buffer of `size` bytes, which all threads of a kernel read.
    pub(crate) fn allocate_uniform(&self, size: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        self.allocate("batch", size, usage)
    }

    /// Allocates a buffer of `size` bytes that the CPU reads.
    pub(crate) fn allocate_staging(&self, size: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        self.allocate("staging", size, usage)
    }

    /// Waits until the device has run all submitted commands.
    pub(crate) fn wait_for_commands(&self) -> Result<(), GpuError> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        // a lost device must be reported as `DeviceLost`, not as a failed poll
        self.take_error()?;
        waited.map_err(|error| self.command_failed(error))?;
        Ok(())
    }

    /// Returns the contents of a GPU buffer that is mapped to the CPU.
    pub(crate) fn read_mapped<T: bytemuck::Pod>(
        &self,
        staging: &wgpu::Buffer,
    ) -> Result<Vec<T>, GpuError> {
        let view = staging.get_mapped_range(..).map_err(|error| self.command_failed(error))?;
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

    pub(crate) fn command_failed(&self, error: impl fmt::Display) -> GpuError {
        GpuError::CommandFailed { adapter: self.adapter.name.clone(), reason: error.to_string() }
    }
}

/// Compares the identity of two GPU devices: clones of one device are equal.
impl PartialEq for GpuDevice {
    fn eq(&self, other: &GpuDevice) -> bool {
        self.device == other.device
    }
}

impl fmt::Debug for GpuDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "GpuDevice({})", self.adapter)
    }
}

/// Installs callbacks that record the errors of a GPU device and returns the record. Without
/// callbacks wgpu panics.
fn record_errors_of(device: &wgpu::Device, name: &str) -> FirstError {
    let first_error = FirstError::default();
    let (lost, failed) = (first_error.clone(), first_error.clone());
    let (of_lost, of_failed) = (name.to_owned(), name.to_owned());
    device.set_device_lost_callback(move |_, reason| {
        let adapter = of_lost.clone();
        record_error(&lost, GpuError::DeviceLost { adapter, reason });
    });
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        let (adapter, reason) = (of_failed.clone(), error.to_string());
        record_error(&failed, GpuError::CommandFailed { adapter, reason });
    }));
    first_error
}

/// Records an error of a GPU device if it is the first, since later ones follow from it; the loss
/// of the device replaces other errors.
fn record_error(first_error: &FirstError, error: GpuError) {
    let mut first_error = lock_even_if_poisoned(first_error);
    let known = matches!(&*first_error, Some(GpuError::DeviceLost { .. }));
    if first_error.is_none() || (!known && matches!(error, GpuError::DeviceLost { .. })) {
        *first_error = Some(error);
    }
}

/// Locks a mutex, even if a thread panicked while it held the lock: no code that holds a lock in
/// this crate leaves a value half written.
pub(crate) fn lock_even_if_poisoned<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

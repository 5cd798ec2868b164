//! Kernel times by the device's own clock.

use crate::gpu::device::GpuDevice;
use crate::gpu::error::GpuError;

/// Number of bytes of a GPU timestamp.
const BYTES: u64 = 8;

/// GPU timestamps before and after each kernel of a sequence.
pub(crate) struct KernelTimer {
    queries: wgpu::QuerySet,
    count: u32,
}

impl KernelTimer {
    /// Creates a timer of `kernels` GPU kernels; [`GpuError::CommandFailed`] if the adapter has no
    /// timestamps.
    pub fn new(device: &GpuDevice, kernels: usize) -> Result<KernelTimer, GpuError> {
        let features = device.device.features();
        if !features.contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Err(device.command_failed("the adapter has no timestamps"));
        }
        let count = 2 * kernels as u32;
        let queries = device.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("kernel times"),
            ty: wgpu::QueryType::Timestamp,
            count,
        });
        Ok(KernelTimer { queries, count })
    }

    /// Returns the descriptor of a compute pass that runs kernel `kernel` alone and writes its
    /// timestamps.
    pub fn timed_pass_descriptor(&self, kernel: usize) -> wgpu::ComputePassDescriptor<'_> {
        let first = 2 * kernel as u32;
        wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(first),
                end_of_pass_write_index: Some(first + 1),
            }),
        }
    }

    /// Submits the recorded GPU commands and returns the seconds of each kernel.
    pub fn submit_and_read_seconds(
        self,
        device: &GpuDevice,
        mut encoder: wgpu::CommandEncoder,
    ) -> Result<Vec<f64>, GpuError> {
        let size = BYTES * u64::from(self.count);
        let resolved = device.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let staging = device.allocate_staging(size);
        encoder.resolve_query_set(&self.queries, 0..self.count, &resolved, 0);
        encoder.copy_buffer_to_buffer(&resolved, 0, &staging, 0, size);
        device.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        device.wait_for_commands()?;
        let ticks: Vec<u64> = device.read_mapped(&staging)?;
        let seconds = f64::from(device.queue.get_timestamp_period()) * 1e-9;
        let kernels = ticks.as_chunks::<2>().0.iter();
        // timestamps out of order count as zero seconds instead of overflowing
        Ok(kernels.map(|[begun, ended]| seconds * ended.saturating_sub(*begun) as f64).collect())
    }
}

//! Compute plans on a GPU: compiled kernels and allocated buffers.

use crate::gpu::compiled_kernel::CompiledKernel;
use crate::gpu::device::GpuDevice;
use crate::gpu::error::GpuError;
use crate::gpu::kernel_dispatch::BufferSlot;
use crate::gpu::plan::{BufferLength, ComputePlan};
use crate::gpu::timer::KernelTimer;

/// Number of bytes of a [`BatchUniforms`] in the memory layout of the kernels.
const BATCH_BYTES: u64 = 32;

/// Description of a batch of samples, which all kernels of a pass can read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BatchUniforms {
    /// Number of samples in the batch.
    pub samples: usize,
    /// Index of the batch's first sample in the order of samples that kernels read from a buffer,
    /// such as the shuffled order of an epoch.
    pub start: usize,
    /// Index of the batch in the sequence of batches.
    pub index: usize,
    /// Further numbers that the kernels read, such as learning rates.
    pub extra_numbers: [f32; 4],
}

/// Selection of the network passes that a [`CompiledPlan`] runs on the GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassesToRun {
    /// Forward pass of the networks only.
    Forward,
    /// Backward pass, and the kernels of the compute plan that run after it.
    Backward,
    /// Forward pass, backward pass, and the kernels of the compute plan that run after it.
    All,
}

/// Compute plan that is compiled for a GPU, with memory for batches of up to a chosen number of
/// samples.
pub struct CompiledPlan {
    device: GpuDevice,
    samples: usize,
    uniform: wgpu::Buffer,
    buffers: Vec<wgpu::Buffer>,
    forward: Vec<CompiledKernel>,
    backward: Vec<CompiledKernel>,
}

impl CompiledPlan {
    /// Compiles the kernels of a compute plan and allocates its buffers, filled with zeros except
    /// for constants.
    ///
    /// # Errors
    /// [`GpuError::BufferTooLarge`] before anything is allocated when the batch is too large for
    /// the adapter, [`GpuError::DeviceLost`] and [`GpuError::CommandFailed`].
    pub fn new(
        device: &GpuDevice,
        plan: &ComputePlan,
        samples: usize,
    ) -> Result<CompiledPlan, GpuError> {
        plan.check_limits(device.adapter(), samples)?;
        let buffer = |length: &BufferLength| device.allocate_storage(length.bytes(samples));
        let buffers: Vec<wgpu::Buffer> = plan.buffer_lengths.iter().map(buffer).collect();
        let uniform = device.allocate_uniform(BATCH_BYTES);
        let kernel = |kernel| CompiledKernel::new(device, kernel, &uniform, &buffers);
        let program = CompiledPlan {
            device: device.clone(),
            samples,
            forward: plan.forward.iter().map(kernel).collect(),
            backward: plan.backward_kernels().map(kernel).collect(),
            uniform,
            buffers,
        };
        for (slot, words) in &plan.constant_tables {
            program.write_words(*slot, words);
        }
        device.take_error()?;
        Ok(program)
    }

    /// Returns the GPU device that the plan runs on.
    pub fn device(&self) -> &GpuDevice {
        &self.device
    }

    /// Returns the maximum number of samples of a batch that the plan has memory for.
    pub fn max_samples(&self) -> usize {
        self.samples
    }

    /// Writes `numbers` to the front of a GPU buffer; commands that are submitted later read them.
    ///
    /// # Panics
    /// When there are more numbers than the buffer holds.
    pub fn write_floats(&self, slot: BufferSlot, numbers: &[f32]) {
        self.write_bytes(slot, bytemuck::cast_slice(numbers));
    }

    /// Writes 32-bit integers to the front of a GPU buffer; commands that are submitted later read
    /// them.
    ///
    /// # Panics
    /// When there are more numbers than the buffer holds.
    pub fn write_words(&self, slot: BufferSlot, words: &[u32]) {
        self.write_bytes(slot, bytemuck::cast_slice(words));
    }

    /// Writes bytes to the front of a GPU buffer, four to a word, the first one lowest; commands
    /// that are submitted later read them. The last word is padded with zeros.
    ///
    /// # Panics
    /// When there are more bytes than the buffer holds.
    pub fn write_bytes(&self, slot: BufferSlot, bytes: &[u8]) {
        let buffer = &self.buffers[slot.0];
        let (got, most) = (bytes.len() as u64, buffer.size());
        assert!(got <= most, "got {got} bytes for a buffer, expected at most {most}");
        // wgpu writes whole words only
        let (words, rest) = bytes.split_at(bytes.len() - bytes.len() % 4);
        let queue = &self.device.queue;
        queue.write_buffer(buffer, 0, words);
        if !rest.is_empty() {
            let mut last = [0; 4];
            last[..rest.len()].copy_from_slice(rest);
            queue.write_buffer(buffer, words.len() as u64, &last);
        }
    }

    /// Submits passes over a batch to the GPU in one command buffer. They run after earlier
    /// submissions; [`read_floats`](CompiledPlan::read_floats) waits for them.
    ///
    /// # Panics
    /// When the batch has more samples than there is memory for.
    pub fn submit_passes(&self, passes: PassesToRun, batch: BatchUniforms) {
        let (got, most) = (batch.samples, self.samples);
        assert!(got <= most, "got a batch of {got} samples, expected at most {most}");
        self.write_batch(batch);
        let mut encoder = self.encoder();
        let mut pass = encoder.begin_compute_pass(&Default::default());
        self.kernels(passes).for_each(|kernel| kernel.record_dispatch(got, &mut pass));
        drop(pass);
        self.device.queue.submit([encoder.finish()]);
    }

    /// Waits for all submitted commands and returns the first numbers of GPU buffers; each request
    /// names a buffer and how many numbers to read.
    ///
    /// # Errors
    /// [`GpuError::DeviceLost`] and [`GpuError::CommandFailed`], also for earlier errors.
    pub fn read_floats<const N: usize>(
        &self,
        requests: [(BufferSlot, usize); N],
    ) -> Result<[Vec<f32>; N], GpuError> {
        let mut encoder = self.encoder();
        let staging = requests.map(|(slot, numbers)| {
            let size = 4 * numbers as u64;
            let buffer = self.device.allocate_staging(size);
            encoder.copy_buffer_to_buffer(&self.buffers[slot.0], 0, &buffer, 0, size);
            buffer
        });
        self.device.queue.submit([encoder.finish()]);
        for buffer in &staging {
            // `read_mapped` reports a failed mapping below
            buffer.map_async(wgpu::MapMode::Read, .., |_| ());
        }
        self.device.wait_for_commands()?;
        let mut read = [const { Vec::new() }; N];
        for (numbers, buffer) in read.iter_mut().zip(&staging) {
            *numbers = self.device.read_mapped(buffer)?;
        }
        Ok(read)
    }

    /// Runs passes over a batch kernel by kernel and returns name and seconds of each kernel, in
    /// the order of execution, by the device's clock. Kernels do not overlap here, so the sum may
    /// exceed the time of [`submit_passes`](CompiledPlan::submit_passes).
    ///
    /// # Errors
    /// [`GpuError::CommandFailed`] if the adapter has no timestamps, and the errors of
    /// [`read_floats`](CompiledPlan::read_floats).
    ///
    /// # Panics
    /// When the batch has more samples than there is memory for.
    pub fn time_kernels(
        &self,
        passes: PassesToRun,
        batch: BatchUniforms,
    ) -> Result<Vec<(&'static str, f64)>, GpuError> {
        assert!(
            batch.samples <= self.samples,
            "got a batch of {} samples, expected at most {}",
            batch.samples,
            self.samples
        );
        self.write_batch(batch);
        let commands: Vec<&CompiledKernel> = self.kernels(passes).collect();
        let clock = KernelTimer::new(&self.device, commands.len())?;
        let mut encoder = self.encoder();
        for (index, kernel) in commands.iter().enumerate() {
            let mut pass = encoder.begin_compute_pass(&clock.timed_pass_descriptor(index));
            kernel.record_dispatch(batch.samples, &mut pass);
        }
        let seconds = clock.submit_and_read_seconds(&self.device, encoder)?;
        Ok(commands.iter().map(|c| c.label()).zip(seconds).collect())
    }

    fn kernels(&self, passes: PassesToRun) -> impl Iterator<Item = &CompiledKernel> {
        let (forward, backward) = match passes {
            PassesToRun::Forward => (&self.forward[..], &[][..]),
            PassesToRun::Backward => (&[][..], &self.backward[..]),
            PassesToRun::All => (&self.forward[..], &self.backward[..]),
        };
        forward.iter().chain(backward)
    }

    fn write_batch(&self, batch: BatchUniforms) {
        let [a, b, c, d] = batch.extra_numbers.map(f32::to_bits);
        let [samples, start, index] = [batch.samples, batch.start, batch.index].map(|n| n as u32);
        // the layout of `Batch` in common.wgsl, where a vec4 is aligned to 16 bytes
        let words = [samples, start, index, 0, a, b, c, d];
        let queue = &self.device.queue;
        queue.write_buffer(&self.uniform, 0, bytemuck::cast_slice(&words));
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.device.create_command_encoder(&Default::default())
    }
}

//! A device that runs kernels.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::gpu::adapter::{Adapter, describe, found};
use crate::gpu::error::GpuError;
use crate::gpu::step::Step;

/// Groups of threads in one line of a dispatch; every adapter takes as many.
const GROUPS_OF_A_LINE: usize = 32_768;

/// An opened adapter. Clones are the same device.
#[derive(Clone)]
pub struct Device {
    adapter: Adapter,
    device: wgpu::Device,
    queue: wgpu::Queue,
    /// Compiled kernels by their text.
    pipelines: Arc<Mutex<HashMap<String, wgpu::ComputePipeline>>>,
    fault: Fault,
}

/// The first thing that went wrong, if anything did.
type Fault = Arc<Mutex<Option<GpuError>>>;

/// A step with its compiled kernel and its buffers.
pub(crate) struct Command {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    step: Step,
}

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
        let index = names
            .iter()
            .position(|name| name.to_lowercase().contains(&wanted));
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
        })
    }

    /// The adapter.
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// Gives the device up, as a driver does that is reset: whatever is asked of it from here on is
    /// [`GpuError::Lost`].
    pub fn close(&self) {
        self.device.destroy();
        let reason = "it was closed".to_owned();
        let adapter = self.adapter.name.clone();
        note(&self.fault, GpuError::Lost { adapter, reason });
    }

    /// What went wrong, if anything did since the device was opened.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        match &*locked(&self.fault) {
            Some(fault) => Err(fault.clone()),
            None => Ok(()),
        }
    }

    /// A buffer of so many bytes, of zeros, for kernels.
    pub(crate) fn buffer(&self, size: u64) -> wgpu::Buffer {
        let copied = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        self.allocate("values", size, wgpu::BufferUsages::STORAGE | copied)
    }

    /// The buffer of the number of samples.
    pub(crate) fn uniform(&self) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        self.allocate("samples", 16, usage)
    }

    /// A buffer that the processor reads.
    fn staging(&self, size: u64) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        self.allocate("staging", size, usage)
    }

    fn allocate(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Writes to the front of a buffer before the next commands.
    pub(crate) fn write<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, values: &[T]) {
        self.queue
            .write_buffer(buffer, 0, bytemuck::cast_slice(values));
    }

    /// Compiles a step; `buffers` are those of its plan.
    pub(crate) fn command(
        &self,
        step: &Step,
        uniform: &wgpu::Buffer,
        buffers: &[wgpu::Buffer],
    ) -> Command {
        let layout = self.layout(step);
        let own = step.buffers.iter().map(|(slot, _)| &buffers[slot.0]);
        let entries = std::iter::once(uniform).chain(own).enumerate();
        let entries = entries.map(|(binding, buffer)| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: buffer.as_entire_binding(),
        });
        let entries: Vec<_> = entries.collect();
        Command {
            bindings: self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(step.label),
                layout: &layout,
                entries: &entries,
            }),
            pipeline: self.pipeline(step, &layout),
            step: step.clone(),
        }
    }

    fn layout(&self, step: &Step) -> wgpu::BindGroupLayout {
        let storage = step
            .buffers
            .iter()
            .map(|&(_, written)| wgpu::BufferBindingType::Storage {
                read_only: !written,
            });
        let types = std::iter::once(wgpu::BufferBindingType::Uniform).chain(storage);
        let entries = types
            .enumerate()
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding: binding as u32,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            });
        let entries: Vec<_> = entries.collect();
        self.device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(step.label),
                entries: &entries,
            })
    }

    fn pipeline(&self, step: &Step, layout: &wgpu::BindGroupLayout) -> wgpu::ComputePipeline {
        let mut pipelines = locked(&self.pipelines);
        if let Some(pipeline) = pipelines.get(&step.source) {
            return pipeline.clone();
        }
        let pipeline = self.compile(step, layout);
        pipelines.insert(step.source.clone(), pipeline.clone());
        pipeline
    }

    fn compile(&self, step: &Step, layout: &wgpu::BindGroupLayout) -> wgpu::ComputePipeline {
        let label = Some(step.label);
        let module = self
            .device
            .create_shader_module(wgpu::ShaderModuleDescriptor {
                label,
                source: wgpu::ShaderSource::Wgsl(step.source.as_str().into()),
            });
        let layout = self
            .device
            .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label,
                bind_group_layouts: &[Some(layout)],
                immediate_size: 0,
            });
        self.device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label,
                layout: Some(&layout),
                module: &module,
                entry_point: Some("main"),
                // kernels write what they share before they read it
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            })
    }

    /// Runs commands for so many samples, one after the other, then reads the first `words` numbers
    /// of some buffers.
    ///
    /// # Errors
    /// [`GpuError::Lost`] and [`GpuError::Failed`], also for what went wrong before.
    pub(crate) fn run<'a, const N: usize>(
        &self,
        commands: impl IntoIterator<Item = &'a Command>,
        samples: usize,
        results: [(&wgpu::Buffer, usize); N],
    ) -> Result<[Vec<f32>; N], GpuError> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        commands
            .into_iter()
            .for_each(|command| command.record(samples, &mut pass));
        drop(pass);
        let staged = results.map(|(buffer, words)| {
            let staged = self.staging(4 * words as u64);
            encoder.copy_buffer_to_buffer(buffer, 0, &staged, 0, 4 * words as u64);
            staged
        });
        self.queue.submit([encoder.finish()]);
        for staged in &staged {
            // whether it was mapped is seen below
            staged.map_async(wgpu::MapMode::Read, .., |_| ());
        }
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|error| self.failed(error))?;
        let mut read = [const { Vec::new() }; N];
        for (read, staged) in read.iter_mut().zip(&staged) {
            let view = staged
                .get_mapped_range(..)
                .map_err(|error| self.failed(error))?;
            *read = bytemuck::pod_collect_to_vec(&view);
        }
        Ok(read)
    }

    fn failed(&self, error: impl fmt::Display) -> GpuError {
        GpuError::Failed {
            adapter: self.adapter.name.clone(),
            reason: error.to_string(),
        }
    }
}

impl Command {
    fn record(&self, samples: usize, pass: &mut wgpu::ComputePass) {
        let groups = self.step.work.count(samples);
        let line = groups.min(GROUPS_OF_A_LINE);
        if line == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(line as u32, groups.div_ceil(line) as u32, 1);
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

/// Keeps the first fault; later ones follow from it.
fn note(fault: &Fault, error: GpuError) {
    locked(fault).get_or_insert(error);
}

/// What a mutex holds. Nothing that runs under it can leave it half written.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

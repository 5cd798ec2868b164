//! Compiled kernels with their buffers.

use std::collections::hash_map::Entry;

use crate::gpu::device::{GpuDevice, lock_even_if_poisoned};
use crate::gpu::kernel_dispatch::KernelDispatch;

/// Maximum number of workgroups along the first axis of a GPU dispatch, below the limit of 65,535
/// that every adapter has; more of them fill further lines along the second axis.
const MAX_WORKGROUPS_X: usize = 32_768;

/// GPU kernel that is compiled and bound to its buffers.
pub(crate) struct CompiledKernel {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    dispatch: KernelDispatch,
}

impl CompiledKernel {
    /// Compiles a kernel of a compute plan; `buffers` are all buffers of the plan.
    pub fn new(
        device: &GpuDevice,
        kernel: &KernelDispatch,
        uniform: &wgpu::Buffer,
        buffers: &[wgpu::Buffer],
    ) -> CompiledKernel {
        let layout = layout(&device.device, kernel);
        let own = kernel.buffers.iter().map(|(slot, _)| &buffers[slot.0]);
        let entries = std::iter::once(uniform).chain(own).enumerate();
        let entries = entries.map(|(binding, buffer)| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: buffer.as_entire_binding(),
        });
        let entries: Vec<_> = entries.collect();
        let bindings = wgpu::BindGroupDescriptor {
            label: Some(kernel.label),
            layout: &layout,
            entries: &entries,
        };
        CompiledKernel {
            bindings: device.device.create_bind_group(&bindings),
            pipeline: pipeline(device, kernel, &layout),
            dispatch: kernel.clone(),
        }
    }

    /// Returns the name of the kernel.
    pub fn label(&self) -> &'static str {
        self.dispatch.label
    }

    /// Records a dispatch of the kernel in a compute pass, for a batch of `samples` samples.
    pub fn record_dispatch(&self, samples: usize, pass: &mut wgpu::ComputePass) {
        let groups = self.dispatch.workgroups.num_workgroups(samples);
        // larger dispatches fill a plane, because every dimension has a limit
        let line = groups.min(MAX_WORKGROUPS_X);
        if line == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(line as u32, groups.div_ceil(line) as u32, 1);
    }
}

fn layout(device: &wgpu::Device, kernel: &KernelDispatch) -> wgpu::BindGroupLayout {
    let storage = kernel.buffers.iter().map(|&(_, written)| {
        let read_only = !written;
        wgpu::BufferBindingType::Storage { read_only }
    });
    let types = std::iter::once(wgpu::BufferBindingType::Uniform).chain(storage);
    let entries = types.zip(0..).map(|(ty, binding)| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    });
    let entries: Vec<_> = entries.collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(kernel.label),
        entries: &entries,
    })
}

/// Returns the compute pipeline of a kernel; kernels with equal text are compiled once.
fn pipeline(
    device: &GpuDevice,
    kernel: &KernelDispatch,
    layout: &wgpu::BindGroupLayout,
) -> wgpu::ComputePipeline {
    let mut pipelines = lock_even_if_poisoned(&device.pipelines);
    let known = pipelines.entry(kernel.wgsl_source(device.uses_subgroup_operations()));
    match known {
        Entry::Occupied(known) => known.get().clone(),
        Entry::Vacant(place) => {
            let pipeline = compile(&device.device, kernel.label, place.key(), layout);
            place.insert(pipeline).clone()
        }
    }
}

fn compile(
    device: &wgpu::Device,
    label: &str,
    source: &str,
    layout: &wgpu::BindGroupLayout,
) -> wgpu::ComputePipeline {
    let label = Some(label);
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label,
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label,
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label,
        layout: Some(&layout),
        module: &module,
        entry_point: Some("main"),
        // kernels write shared memory before they read it
        compilation_options: wgpu::PipelineCompilationOptions {
            zero_initialize_workgroup_memory: false,
            ..Default::default()
        },
        cache: None,
    })
}

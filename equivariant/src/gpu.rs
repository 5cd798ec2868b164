//! GPU versions of the layers, through wgpu's Vulkan back end.
//!
//! [`available_gpu_adapters`] lists the GPUs and [`GpuDevice::open`] opens one of them. A
//! [`GpuLayer`] is a layer or a chain of layers on a device: parameters, activations and gradients
//! stay there. A [`ComputePlan`] combines several layers with kernels of other crates, such as a
//! loss, and a [`CompiledPlan`] is a plan on a device.
//!
//! A convolution is three kernels, each for all irreps at once: patches are folded by parity,
//! multiplied by the blocks of parameters and, in the backward pass, unfolded. The numbers of a
//! field, one for each irrep, form a WGSL vector, and matrices of such vectors are multiplied
//! component by component. Kernels are text in `wgsl/`, to which the layer's sizes are added as
//! constants. The order of sums in a product is fixed. Sums over the threads of a workgroup use
//! subgroup operations if the adapter has them and a fixed tree otherwise; an adapter gives the
//! same bits each time.

mod adapter;
mod channels;
mod compiled_kernel;
mod device;
mod error;
mod kernel_dispatch;
mod kernels;
mod network;
mod plan;
mod program;
mod timer;

pub use adapter::{GpuAdapterInfo, GpuAdapterKind, available_gpu_adapters};
pub use device::GpuDevice;
pub use error::GpuError;
pub use kernel_dispatch::{BufferSlot, KernelDispatch, WorkgroupCount};
pub use network::{GpuLayer, LayerGradients};
pub use plan::{ComputePlan, PlannedFeatureMap};
pub use program::{BatchUniforms, CompiledPlan, PassesToRun};

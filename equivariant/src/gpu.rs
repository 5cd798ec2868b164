//! The same layers on a GPU, through wgpu's Vulkan back end.
//!
//! [`adapters`] lists what there is and [`Device::open`] opens one of them. A [`Network`] is a
//! layer or a chain of layers on a device: parameters, activations and gradients stay there. A
//! [`Plan`] joins several layers with kernels of somebody else, such as a loss, and a [`Program`]
//! is a plan on a device.
//!
//! A convolution is three kernels, each for all irreps at once: patches are folded by parity,
//! multiplied by the blocks of parameters, and, in the backward pass, unfolded. All numbers of a
//! field, one for each irrep, are a vector of WGSL, and products of matrices of such vectors
//! multiply number by number. Kernels are text in `wgsl/`, to which the layer's sizes are added as
//! constants. Products have a fixed order of sums. Sums over the threads of a group use operations
//! on subgroups where the adapter has them, and an order of their own elsewhere; an adapter gives
//! the same bits each time.

mod adapter;
mod channels;
mod clock;
mod command;
mod device;
mod error;
mod kernels;
mod network;
mod plan;
mod program;
mod step;

pub use adapter::{Adapter, AdapterKind, adapters};
pub use device::Device;
pub use error::GpuError;
pub use network::{Gradients, Network};
pub use plan::{Plan, Tensor};
pub use program::{Batch, Passes, Program};
pub use step::{Slot, Step, Work};

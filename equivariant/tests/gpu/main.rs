//! Networks on a GPU against the same networks on the CPU. A software driver will do.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

#[path = "../common/mod.rs"]
mod common;
mod devices;
mod plans;
mod registry;

use std::sync::OnceLock;

use equivariant::gpu::GpuDevice;

/// Returns the device of most tests, which compiles every kernel once.
fn device() -> &'static GpuDevice {
    static DEVICE: OnceLock<GpuDevice> = OnceLock::new();
    DEVICE.get_or_init(|| GpuDevice::open(None).unwrap())
}

//! Networks on a GPU against the same networks on the CPU. A software driver will do.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

#[path = "../common/mod.rs"]
mod common;
mod devices;
mod plans;
mod registry;

use std::sync::OnceLock;

use equivariant::gpu::Device;

/// Returns the device of most tests, which compiles every kernel once.
fn device() -> &'static Device {
    static DEVICE: OnceLock<Device> = OnceLock::new();
    DEVICE.get_or_init(|| Device::open(None).unwrap())
}

//! Updates and decisions on a GPU against those of the CPU. A software driver will do.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

use std::sync::OnceLock;

use equivariant::gpu::GpuDevice;

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod common;
mod decisions;
mod update;

/// Of the largest value of the CPU's.
const TOLERANCE: f32 = 1e-4;

fn device() -> &'static GpuDevice {
    static DEVICE: OnceLock<GpuDevice> = OnceLock::new();
    DEVICE.get_or_init(|| GpuDevice::open(None).unwrap())
}

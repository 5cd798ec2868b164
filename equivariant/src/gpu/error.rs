//! Errors of networks on GPUs.

use thiserror::Error;

/// Reason why a network cannot run on a device.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No GPU adapter at all, or none with the requested name.
    #[error(
        "got no adapter {wanted}, expected one of [{}]; install a Vulkan driver, for instance \
         Debian's mesa-vulkan-drivers, which needs no hardware",
        found.join(", ")
    )]
    NoAdapter {
        /// Description of the requested adapter, in words.
        wanted: String,
        /// Names of the available adapters.
        found: Vec<String>,
    },
    /// Adapter whose driver cannot open a device.
    #[error("{adapter}: opens no device: {reason}")]
    NoDevice {
        /// Name of the adapter whose driver cannot open a device.
        adapter: String,
        /// Message of the driver about the device that it cannot open.
        reason: String,
    },
    /// Network that needs larger buffers than the adapter has; nothing was allocated.
    #[error(
        "{adapter}: got a network with {needed} {what}, expected at most {limit}; lower the number \
         of samples or the widths"
    )]
    BufferTooLarge {
        /// Name of the adapter whose buffers are too small.
        adapter: String,
        /// Name of the limit that the network exceeds.
        what: &'static str,
        /// Size in bytes of the network's largest buffer.
        needed: u64,
        /// Size in bytes that the adapter allows.
        limit: u64,
    },
    /// Layer that has no kernels for GPUs.
    #[error(
        "{layer}: got a layer without GPU kernels, expected one of this crate's; run it on the CPU"
    )]
    UnsupportedLayer {
        /// Description of the layer without kernels.
        layer: String,
    },
    /// Lost device: the driver was reset or updated, or the hardware was removed or failed.
    #[error(
        "{adapter}: the device is lost: {reason}; continue from the last checkpoint on another device"
    )]
    DeviceLost {
        /// Name of the lost adapter.
        adapter: String,
        /// Message of the driver about the lost device.
        reason: String,
    },
    /// Command that the driver rejected, for instance for lack of memory.
    #[error("{adapter}: a command failed: {reason}")]
    CommandFailed {
        /// Name of the adapter whose driver rejected the command.
        adapter: String,
        /// Message of the driver about the rejected command.
        reason: String,
    },
}

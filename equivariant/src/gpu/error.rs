//! Errors of GPUs.

use thiserror::Error;

/// Reason why a network cannot run on a device.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter at all, or none with the requested name.
    #[error(
        "got no adapter {wanted}, expected one of [{}]; install a Vulkan driver, for instance \
         Debian's mesa-vulkan-drivers, which needs no hardware",
        found.join(", ")
    )]
    NoAdapter {
        /// Requested adapter.
        wanted: String,
        /// Names of the available adapters.
        found: Vec<String>,
    },
    /// An adapter whose driver cannot open a device.
    #[error("{adapter}: opens no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        reason: String,
    },
    /// A network that needs more than the adapter has; nothing was allocated.
    #[error(
        "{adapter}: got a network with {needed} {what}, expected at most {limit}; lower the number \
         of samples or the widths"
    )]
    Limit {
        /// Name of the adapter.
        adapter: String,
        /// Name of the limit.
        what: &'static str,
        /// Amount that the network needs.
        needed: u64,
        /// Amount that the adapter has.
        limit: u64,
    },
    /// A layer without kernels.
    #[error(
        "{layer}: got a layer without GPU kernels, expected one of this crate's; run it on the \
         CPU"
    )]
    Layer {
        /// Description of the layer.
        layer: String,
    },
    /// A lost device: the driver was reset or updated, or the hardware was removed or failed.
    #[error(
        "{adapter}: the device is lost: {reason}; go on from the last checkpoint on another device"
    )]
    Lost {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        reason: String,
    },
    /// A command that the driver rejected, for instance for lack of memory.
    #[error("{adapter}: a command failed: {reason}")]
    Failed {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        reason: String,
    },
}

//! Why a GPU cannot be used.

use thiserror::Error;

/// What keeps a network from running on a device.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter, or none of that name.
    #[error(
        "got no adapter {wanted}, expected one of [{}]; install a Vulkan driver, for instance \
         Debian's mesa-vulkan-drivers, which needs no hardware",
        found.join(", ")
    )]
    NoAdapter {
        /// What was looked for.
        wanted: String,
        /// The names of those that there are.
        found: Vec<String>,
    },
    /// The driver opens no device on the adapter.
    #[error("{adapter}: opens no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
    /// The network needs more than the adapter has; nothing was allocated.
    #[error(
        "{adapter}: got a network with {needed} {what}, expected at most {limit}; lower the number \
         of samples or the widths"
    )]
    Limit {
        /// Name of the adapter.
        adapter: String,
        /// What is too large.
        what: &'static str,
        /// What the network needs.
        needed: u64,
        /// What the adapter has.
        limit: u64,
    },
    /// A layer has no kernels.
    #[error(
        "{layer}: got a layer without GPU kernels, expected one of this crate's; run it on the \
         processor"
    )]
    Layer {
        /// What the layer prints.
        layer: String,
    },
    /// The device is gone: the driver was reset or updated, the hardware was removed or failed.
    #[error(
        "{adapter}: the device is lost: {reason}; go on from the last checkpoint on another device"
    )]
    Lost {
        /// Name of the adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
    /// The driver refused a command, for instance for lack of memory.
    #[error("{adapter}: a command failed: {reason}")]
    Failed {
        /// Name of the adapter.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
}

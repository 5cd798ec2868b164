//! Devices on which policies learn.

use clap::ValueEnum;

use crate::error::CoversError;

/// Device that the updates of policies run on.
///
/// It is in no settings and in no checkpoint, so a run may go on elsewhere; a run's provenance
/// names the GPU. Sums are rounded in another way there, so the same bits come only where nothing
/// changes.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum LearningDevice {
    /// On the processor.
    #[default]
    Processor,
    /// On a GPU.
    #[cfg(feature = "wgpu")]
    Gpu(rl::gpu::Device),
}

impl LearningDevice {
    /// Returns the GPU's name, if it is one.
    pub fn gpu(&self) -> Option<&str> {
        match self {
            Self::Processor => None,
            #[cfg(feature = "wgpu")]
            Self::Gpu(device) => Some(&device.adapter().name),
        }
    }
}

/// Choice of the device that policies learn on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceChoice {
    /// On the processor.
    #[default]
    Cpu,
    /// On the first GPU, or on a Vulkan driver that stands in for one.
    Gpu,
    /// On the first GPU if there is one, else on the processor. A GPU that cannot be opened is an
    /// error.
    Auto,
}

impl DeviceChoice {
    /// Opens the chosen device, for a learner whose updates can run on a GPU.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a GPU where the program was built without the feature `wgpu`;
    /// [`RlError::Gpu`](rl::RlError) where there is none.
    pub fn open(self) -> Result<LearningDevice, CoversError> {
        match self {
            Self::Cpu => Ok(LearningDevice::Processor),
            Self::Gpu => first_gpu(),
            Self::Auto if hardware() => first_gpu(),
            Self::Auto => Ok(LearningDevice::Processor),
        }
    }
}

#[cfg(feature = "wgpu")]
fn first_gpu() -> Result<LearningDevice, CoversError> {
    let device = rl::gpu::Device::open(None).map_err(rl::RlError::from)?;
    Ok(LearningDevice::Gpu(device))
}

#[cfg(not(feature = "wgpu"))]
fn first_gpu() -> Result<LearningDevice, CoversError> {
    Err(CoversError::Setting {
        name: "device",
        value: "gpu".to_owned(),
        expected: "`cpu` or `auto`: this program was built without `--features wgpu`",
    })
}

/// Tests whether the first adapter is a GPU.
#[cfg(feature = "wgpu")]
fn hardware() -> bool {
    let adapters = rl::gpu::adapters();
    adapters
        .first()
        .is_some_and(|adapter| adapter.kind.is_hardware())
}

#[cfg(not(feature = "wgpu"))]
fn hardware() -> bool {
    false
}

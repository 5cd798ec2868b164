//! Devices that policies train on.

use std::fmt;
use std::str::FromStr;

use crate::error::LearnerError;

/// Opened device on which policies are trained.
///
/// No settings file or checkpoint contains the device, so a run can continue on another one; its
/// provenance names the GPU. Devices round sums differently, so results are bit-identical on one
/// device only.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum LearningDevice {
    /// Training on the CPU.
    #[default]
    Cpu,
    /// Training on this opened GPU.
    #[cfg(feature = "wgpu")]
    Gpu(rl::gpu::GpuDevice),
}

impl LearningDevice {
    /// Returns the name of the GPU; `None` on the CPU.
    pub fn gpu_name(&self) -> Option<&str> {
        match self {
            Self::Cpu => None,
            #[cfg(feature = "wgpu")]
            Self::Gpu(device) => Some(&device.adapter().name),
        }
    }
}

/// Choice of the device that policies train on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// Training on the CPU.
    #[default]
    Cpu,
    /// Training on the first GPU, or on a Vulkan driver that stands in for one.
    Gpu,
    /// Training on the first GPU if there is one, else on the CPU. A GPU that cannot be opened is
    /// an error.
    Auto,
}

impl DeviceChoice {
    /// All choices of a device.
    pub const ALL: [Self; 3] = [Self::Cpu, Self::Gpu, Self::Auto];

    /// Returns the name of the choice, as the option `--device` takes it, such as `gpu`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
            Self::Auto => "auto",
        }
    }

    /// Opens the chosen device, for a learner whose updates can run on a GPU.
    ///
    /// # Errors
    /// [`LearnerError::InvalidSetting`] for a GPU if the program was built without the feature
    /// `wgpu`; [`RlError::Gpu`](rl::RlError) if there is no GPU.
    pub fn open(self) -> Result<LearningDevice, LearnerError> {
        match self {
            Self::Cpu => Ok(LearningDevice::Cpu),
            Self::Gpu => first_gpu(),
            Self::Auto if hardware() => first_gpu(),
            Self::Auto => Ok(LearningDevice::Cpu),
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for DeviceChoice {
    type Err = LearnerError;

    fn from_str(name: &str) -> Result<Self, LearnerError> {
        let found = Self::ALL.into_iter().find(|choice| choice.name() == name);
        found.ok_or_else(|| LearnerError::invalid("device", name, "cpu, gpu or auto"))
    }
}

#[cfg(feature = "wgpu")]
fn first_gpu() -> Result<LearningDevice, LearnerError> {
    let device = rl::gpu::GpuDevice::open(None).map_err(rl::RlError::from)?;
    Ok(LearningDevice::Gpu(device))
}

#[cfg(not(feature = "wgpu"))]
fn first_gpu() -> Result<LearningDevice, LearnerError> {
    let expected = "`cpu` or `auto`: this program was built without `--features wgpu`";
    Err(LearnerError::invalid("device", "gpu", expected))
}

/// Returns `true` if the first adapter of `wgpu` is a hardware GPU.
#[cfg(feature = "wgpu")]
fn hardware() -> bool {
    let adapters = rl::gpu::available_gpu_adapters();
    adapters.first().is_some_and(|adapter| adapter.kind.is_hardware())
}

#[cfg(not(feature = "wgpu"))]
fn hardware() -> bool {
    false
}

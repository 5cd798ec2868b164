//! Options shared by the commands for a robot.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use envs::{Embodiment, EnvError};

use crate::DeployError;
use experiments::{RunError, RunFolder};
use inpainting::InpaintingError::OutOfSight;

use super::calibrate::CameraCalibrationFile;
use super::deployment::Deployment;
use super::faults::{FaultAmount, SimulatedFault};
use super::settings::{RigAndVisionSettings, VisionSettings};

/// Set of faults of a simulated robot and its camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FaultPreset {
    /// Perfect camera and an arm without delay.
    Off,
    /// Faults about as large as those of real robots and cameras.
    Nominal,
}

/// Options that choose the robot, its faults and the seed.
#[derive(Clone, Debug, Args)]
pub struct RigOptions {
    /// Simulated robot: `kinova-sim`, a Kinova Gen3, or an arm of yours as ARM.urdf (default:
    /// kinova-sim).
    #[arg(long, value_name = "ROBOT", value_parser = robot)]
    pub robot: Option<Embodiment>,
    /// Seed of placements and faults.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    pub seed: u64,
    /// Faults of the camera and the arm.
    #[arg(long, value_enum, default_value = "nominal")]
    pub faults: FaultPreset,
    /// Amount of a single fault, as `position-error=30`, with the names and units of `covers deploy
    /// --sweep`; may be given several times, for one fault each.
    #[arg(long = "fault", value_name = "FAULT=AMOUNT")]
    pub fault_amounts: Vec<FaultAmount>,
}

fn robot(name: &str) -> Result<Embodiment, EnvError> {
    if name == "kinova-sim" { Ok(Embodiment::KINOVA_GEN3) } else { name.parse() }
}

impl RigOptions {
    /// Returns the settings of a simulated rig with the faults that the options ask for, and
    /// otherwise the default perception.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for amounts out of range, and for two amounts of one fault.
    pub fn settings(&self) -> Result<RigAndVisionSettings, DeployError> {
        let mut settings = match self.faults {
            FaultPreset::Off => RigAndVisionSettings::NO_FAULTS,
            FaultPreset::Nominal => RigAndVisionSettings::NOMINAL_FAULTS,
        };
        for (number, FaultAmount { fault, amount }) in self.fault_amounts.iter().enumerate() {
            // a second amount would silently replace the first
            if self.fault_amounts[..number].iter().any(|of| of.fault == *fault) {
                return Err(RunError::invalid(
                    "fault",
                    format!("{}, twice", fault.name()),
                    "each fault once",
                )
                .into());
            }
            settings = fault.set_amount(*amount, settings)?;
        }
        Ok(settings)
    }

    /// Returns the robot of a simulated rig.
    pub(crate) fn simulated_robot(&self) -> Embodiment {
        self.robot.unwrap_or(Embodiment::KINOVA_GEN3)
    }

    /// Rejects a robot, single faults, and those of a sweep, for a rig that is not simulated: an
    /// ignored fault would pass for a harmless one.
    pub(crate) fn reject_simulation_options(
        &self,
        swept: impl IntoIterator<Item = SimulatedFault>,
    ) -> Result<(), DeployError> {
        if let Some(robot) = self.robot {
            return Err(RunError::invalid(
                "robot",
                robot.name(),
                "none: a rig that is not simulated has its own robot",
            )
            .into());
        }
        let single = self.fault_amounts.iter().map(|of| of.fault);
        single.chain(swept).next().map_or(Ok(()), |fault| {
            Err(RunError::invalid(
                "fault",
                fault.name(),
                "none: faults are set in simulated rigs alone",
            )
            .into())
        })
    }
}

/// Options that choose the policies, the robot and the camera's calibration.
#[derive(Clone, Debug, Args)]
pub struct RunAndRigOptions {
    /// Folder of a run, or one that `covers pack` made.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub rig: RigOptions,
    /// Calibration of the camera, written by `covers calibrate`, in place of the robot's own.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
}

impl RunAndRigOptions {
    /// Loads the policies of the run, with the perception `vision` and, if the options name a file,
    /// the calibration in it in place of that of `vision`.
    ///
    /// # Errors
    /// As [`CameraCalibrationFile::read`] and [`Deployment::load`].
    pub fn load_deployment(&self, vision: VisionSettings) -> Result<Deployment, DeployError> {
        let read = self.calibration.as_deref().map(CameraCalibrationFile::read);
        let calibration = read.transpose()?.or(vision.calibration);
        let vision = VisionSettings { calibration, ..vision };
        Deployment::load(&RunFolder::from_path(&self.run_folder), vision)
    }

    /// Adds the path of the calibration file to an error that its calibration causes.
    pub(super) fn name_file_in_error<T>(
        &self,
        outcome: Result<T, DeployError>,
    ) -> Result<T, DeployError> {
        use DeployError::{CalibrationFile, ImplausibleCalibration, Inpainting};
        outcome.map_err(|error| match (&self.calibration, error) {
            (
                Some(path),
                source @ (ImplausibleCalibration { .. } | Inpainting(OutOfSight { .. })),
            ) => CalibrationFile { path: path.clone(), source: Box::new(source) },
            (_, other) => other,
        })
    }
}

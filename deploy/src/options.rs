//! Options that the commands for a robot share.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::DeployError;
use experiments::{RunError, RunFolder};

use super::calibrate::CalibrationFile;
use super::deployment::Deployment;
use super::faults::FaultAmount;
use super::settings::SightSettings;
use super::simulated::SimulationSettings;

/// A robot that the commands know.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RobotKind {
    /// A Kinova Gen3 in simulation, which no policy was trained with.
    KinovaSim,
}

/// What is wrong with a simulated robot and its camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Faults {
    /// Nothing.
    Off,
    /// About what is wrong with real ones.
    Nominal,
}

/// The robot, and what is wrong with it.
#[derive(Clone, Debug, Args)]
pub struct RigOptions {
    /// The robot.
    #[arg(long, value_enum, default_value = "kinova-sim")]
    pub robot: RobotKind,
    /// Seed of placements and faults.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// What is wrong with the camera and the arm.
    #[arg(long, value_enum, default_value = "nominal")]
    pub faults: Faults,
    /// So much of one fault instead, as `position-error=30`, with the names and units of `covers
    /// deploy --sweep`; may be given several times, for one fault each.
    #[arg(long, value_name = "FAULT=AMOUNT")]
    pub fault: Vec<FaultAmount>,
}

impl RigOptions {
    /// What is wrong with a simulated rig, and how pictures are looked at.
    ///
    /// # Errors
    /// [`RunError::Setting`] for amounts out of range, and for two amounts of one fault.
    pub fn settings(&self) -> Result<(SimulationSettings, SightSettings), DeployError> {
        let settings = match self.faults {
            Faults::Off => SimulationSettings::OFF,
            Faults::Nominal => SimulationSettings::NOMINAL,
        };
        let mut settings = (settings, SightSettings::default());
        for (number, FaultAmount { fault, amount }) in self.fault.iter().enumerate() {
            if self.fault[..number].iter().any(|of| of.fault == *fault) {
                return Err(RunError::Setting {
                    name: "fault",
                    value: format!("{}, twice", fault.name()),
                    expected: "each fault once",
                }
                .into());
            }
            settings = fault.set(*amount, settings)?;
        }
        Ok(settings)
    }
}

/// A camera's calibration from a file.
#[derive(Clone, Debug, Args)]
pub struct CameraOptions {
    /// The camera's calibration as `covers calibrate` wrote it, in place of the robot's own.
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
}

/// Whose policies act on which robot, and how its camera is seen.
#[derive(Clone, Debug, Args)]
pub struct SiteOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub rig: RigOptions,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub camera: CameraOptions,
}

impl SiteOptions {
    /// The policies, which look through the camera with these settings, or with its calibration
    /// from a file.
    ///
    /// # Errors
    /// As [`CameraOptions::apply`] and [`Deployment::load`].
    pub fn deployment(&self, sight: SightSettings) -> Result<Deployment, DeployError> {
        Deployment::load(&RunFolder::open(&self.run), self.camera.apply(sight)?)
    }
}

impl CameraOptions {
    /// The settings with the calibration, if there is one.
    ///
    /// # Errors
    /// As [`CalibrationFile::read`].
    pub fn apply(&self, settings: SightSettings) -> Result<SightSettings, DeployError> {
        let read = self.calibration.as_deref().map(CalibrationFile::read);
        Ok(SightSettings { calibration: read.transpose()?.or(settings.calibration), ..settings })
    }
}

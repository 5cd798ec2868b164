//! Trials of learnt policies on a robot that a camera watches.
//!
//! A [`Rig`] is a robot with its table, its camera and its clock. [`SimulatedRig`] is one in
//! simulation. Whoever owns an arm implements [`Rig`] for it. A [`Deployment`] lets policies act on
//! a rig: it sees what the camera shows and what the robot says of itself, and nothing else.

mod calibrate;
mod command;
mod deployment;
mod dry_run;
mod error;
mod faults;
mod options;
mod past;
mod pilot;
mod plausibility;
mod results;
mod rig;
mod settings;
mod sight;
mod simulated;
mod stages;
mod strip;
mod sweep;
mod table;
mod trial;

#[cfg(test)]
mod tests;

pub use calibrate::{
    CalibrateOptions, CalibrateSettings, Calibrated, CalibrationFile, LeftOut, MaskCheck,
    MaskOptions, MaskRow, calibrate, poses,
};
pub use command::DeployOptions;
pub use deployment::Deployment;
pub use dry_run::{Rehearsal, Withheld};
pub use error::DeployError;
pub use faults::{Fault, FaultAmount, FaultSweep};
pub use options::{CameraOptions, Faults, RigOptions, RobotKind, SiteOptions};
pub use rig::{Rig, SetUp, Trial, Verdict};
pub use settings::SightSettings;
pub use simulated::{SimulatedRig, SimulationSettings};
pub use stages::{Stage, Stages};
pub use strip::Strip;
pub use table::{TrialScore, deployment_table};

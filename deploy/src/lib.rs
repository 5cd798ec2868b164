//! Trials of trained policies on a robot with a camera, and the calibration of that camera.
//!
//! A [`Rig`] is a robot with its table, its camera and its clock. [`SimulatedRig`] is one in
//! simulation; implement [`Rig`] for an arm of your own. A [`Deployment`] lets policies act on a
//! rig and sees nothing but the camera's pictures and the robot's own state.

mod calibrate;
mod command;
mod controller;
mod deployment;
mod dry_run;
mod error;
mod faults;
mod film_strip;
mod latency;
mod observer;
mod options;
mod plausibility;
mod results;
mod rig;
mod settings;
mod simulated;
mod state_history;
mod sweep;
mod table;
mod trial;

#[cfg(test)]
mod dry_rig;
#[cfg(test)]
mod tests;

pub use calibrate::{
    CalibrateOptions, CameraCalibrationFile, CameraCalibrationResult, CameraCalibrationSettings,
    CheckMaskOptions, MaskCheck, MaskComparison, SkippedPose, calibrate_camera, calibration_poses,
};
pub use command::DeployOptions;
pub use deployment::Deployment;
pub use dry_run::{DryRunReport, UnsentCommand};
pub use error::DeployError;
pub use faults::{FaultAmount, FaultSweep, SimulatedFault};
pub use film_strip::FilmStrip;
pub use latency::{DecisionStage, LatencyProfile};
pub use options::{FaultPreset, RigOptions, RunAndRigOptions};
pub use rig::{PreparedTrial, Rig, TaskVerdict, Trial};
pub use settings::{RigAndVisionSettings, VisionSettings};
pub use simulated::{SimulatedRig, SimulatedRigSettings};
pub use table::{TrialResult, trial_success_table};

//! Trials of learnt policies on a robot that a camera watches.
//!
//! A [`Rig`] is a robot with its table, its camera and its clock. [`SimulatedRig`] is one in
//! simulation. Whoever owns an arm implements [`Rig`] for it. A [`Deployment`] lets policies act on
//! a rig: it sees what the camera shows and what the robot says of itself, and nothing else.

mod command;
mod deployment;
mod faults;
mod past;
mod pilot;
mod rig;
mod settings;
mod sight;
mod simulated;
mod strip;
mod sweep;
mod table;
mod trial;

#[cfg(test)]
mod tests;

pub use command::{DeployOptions, Faults, RobotKind};
pub use deployment::Deployment;
pub use faults::{Fault, FaultSweep};
pub use rig::{Rig, SetUp, Trial, Verdict};
pub use settings::SightSettings;
pub use simulated::{SimulatedRig, SimulationSettings};
pub use strip::Strip;
pub use table::{TrialScore, deployment_table};

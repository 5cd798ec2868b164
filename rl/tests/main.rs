//! The integration tests of this crate as one program, which is compiled and linked once.

#![allow(clippy::unwrap_used, reason = "tests and their helpers")]

mod actions;
mod buffer;
mod collection;
mod common;
mod declared_irreps;
mod discrete;
mod equivariance;
mod learning;
mod memory;
mod numbers;
mod observations;
mod refusals;
mod revaluation;
mod reward_scale;
mod ring;
mod sac;
mod settings;
mod symmetry_faults;
mod update;
